"""Joint states of an armbridge server as a teleoperator of lerobot."""

from lerobot_teleoperator_armbridge.armbridge_teleop import ArmbridgeTeleop
from lerobot_teleoperator_armbridge.config_armbridge_teleop import ArmbridgeTeleopConfig

__all__ = ["ArmbridgeTeleop", "ArmbridgeTeleopConfig"]
