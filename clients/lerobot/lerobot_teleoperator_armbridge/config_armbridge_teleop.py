"""Settings of the teleoperator, as options of lerobot's commands."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_armbridge.config_armbridge import ServerOptions


@TeleoperatorConfig.register_subclass("armbridge")
@dataclass(kw_only=True)
class ArmbridgeTeleopConfig(TeleoperatorConfig, ServerOptions):
    """The arm that leads: ``arm`` of a server, or a topic of sensor_msgs/JointState with its joints.

    Attributes:
        topic: empty for the arm's own joint states.
    """

    topic: str = ""
