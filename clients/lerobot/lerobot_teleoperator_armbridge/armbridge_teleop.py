"""An arm of a server, moved by hand, by its page or by a program, leads a robot of lerobot."""

from __future__ import annotations

from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.types import RobotAction
from lerobot.utils.decorators import check_if_already_connected
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_armbridge.link import ArmLink
from lerobot_teleoperator_armbridge.config_armbridge_teleop import ArmbridgeTeleopConfig


class ArmbridgeTeleop(Teleoperator):
    """Measured positions of an arm on an armbridge server as actions."""

    config_class = ArmbridgeTeleopConfig
    name = "armbridge"

    def __init__(self, config: ArmbridgeTeleopConfig) -> None:
        super().__init__(config)
        self.config = config
        self._link: ArmLink | None = None

    @property
    def action_features(self) -> dict[str, type]:
        """Positions by joint."""
        return {f"{joint}.pos": float for joint in self.config.joints}

    @property
    def feedback_features(self) -> dict[str, type]:
        """Nothing: no force comes back."""
        return {}

    @property
    def is_connected(self) -> bool:
        """True from connect to disconnect."""
        return self._link is not None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002 - lerobot's signature
        """Connect to the server; nothing moves."""
        self._link = ArmLink(self.config, self.config.topic)

    @property
    def is_calibrated(self) -> bool:
        """True: the server reads no arm that is not calibrated."""
        return True

    def calibrate(self) -> None:
        """Do nothing: ``armbridge calibrate`` does it at the server."""

    def configure(self) -> None:
        """Do nothing: the server configures the servos."""

    def get_action(self) -> RobotAction:
        """Return the newest positions."""
        return dict(self._connected.positions())

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing: no force comes back."""

    def disconnect(self) -> None:
        """Close the connection."""
        link, self._link = self._connected, None
        link.arm.close()

    @property
    def _connected(self) -> ArmLink:
        if self._link is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first")
        return self._link
