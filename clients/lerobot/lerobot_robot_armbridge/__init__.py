"""An arm on an armbridge server for lerobot; importing this registers robot, teleoperator and camera."""

import lerobot_teleoperator_armbridge  # noqa: F401 - registers the teleoperator; lerobot imports one module a distribution
from lerobot_robot_armbridge.armbridge import Armbridge, ArmStopped
from lerobot_robot_armbridge.camera import ArmbridgeCamera
from lerobot_robot_armbridge.config_armbridge import ArmbridgeCameraConfig, ArmbridgeConfig

__all__ = [
    "ArmStopped",
    "Armbridge",
    "ArmbridgeCamera",
    "ArmbridgeCameraConfig",
    "ArmbridgeConfig",
]
