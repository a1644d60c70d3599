"""Settings of the robot and of the camera, as options of lerobot's commands."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig

SO101_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@dataclass
class ServerOptions:
    """The server to connect to; it is sent the token in the environment variable ARMBRIDGE_TOKEN.

    Attributes:
        url: ``ws://HOST:PORT``, or ``wss://`` for TLS.
        arm: name of one of several arms; empty for the only arm.
        joints: the arm's joints in the order of the dataset; a name that contains "gripper" is one in percent.
        use_degrees: degrees from the middle of the calibrated range, as lerobot's own default; else -100 to 100 of it.
        dataset: folder of an ``armbridge export`` whose actions, or a policy trained on it, move the arm; an arm with
            another zero or range is refused.
        convert: take the dataset's zeros and ranges for this arm's, so that the same values are the same positions.
    """

    url: str = "ws://127.0.0.1:9090"
    arm: str = ""
    joints: list[str] = field(default_factory=lambda: list(SO101_JOINTS))
    use_degrees: bool = True
    dataset: Path | None = None
    convert: bool = False


@RobotConfig.register_subclass("armbridge")
@dataclass(kw_only=True)
class ArmbridgeConfig(RobotConfig, ServerOptions):
    """The arm, and lerobot's cameras of any type, by the name of each in the dataset."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)


@CameraConfig.register_subclass("armbridge")
@dataclass(kw_only=True)
class ArmbridgeCameraConfig(CameraConfig):
    """A topic of sensor_msgs/CompressedImage; width and height [pixels] must match its images."""

    topic: str = "/camera/image/compressed"
    url: str = "ws://127.0.0.1:9090"
