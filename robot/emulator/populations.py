"""Populations of servos: the states in which the servos of real arms are found."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from robot.calibration import MAX_TICK
from robot.emulator.plant import SQUEEZING, WELL_COOLED, Heating
from robot.hardware.feetech.profiles import LEROBOT
from robot.hardware.feetech.registers import MODELS, Register

# Supply of the SO-101, and of its 12 V variant [V].
SUPPLY_V = 5.0
SUPPLY_12_V = 12.0


@dataclass(frozen=True)
class Population:
    """State of an arm's servos before a program finds them; tuples have a value for each joint in turn, cyclically."""

    # EPROM of each servo, where it differs from a new one's.
    registers: Mapping[Register, int] = field(default_factory=dict)
    gripper: Mapping[Register, int] = field(default_factory=dict)  # the same of the gripper's servo alone
    servo_id: int | None = None  # id of every servo, as the factory leaves it; None for the ids of the calibration
    limits_ticks: tuple[int, int] | None = None  # angle limits of every servo; None for the calibrated ranges
    has_offsets: bool = True  # True if the servos hold the calibration's homing offsets, False if they hold none
    offset_shift_ticks: tuple[int, ...] = (0,)  # added to the homing offset after the arm was calibrated
    # Encoder ticks by which the horns are mounted away from where the calibration has them.
    horn_ticks: tuple[int, ...] = (0,)
    firmware: tuple[int, ...] = (10,)  # minor version of the firmware, behind major version 3
    unlocked: bool = False  # True if the EPROM is found unlocked, as a program has left it
    powers_up_unlocked: bool = False  # True if the EPROM is unlocked after each power-up
    powers_up_holding: bool = False  # True if power-ups leave torque on
    # True if only a power cycle clears an overload, and the servo ignores torque off until then.
    overload_latches: bool = False
    supply_v: float = SUPPLY_V  # supply [V]
    gripper_heating: Heating = WELL_COOLED  # heat of the gripper's motor
    # Mechanical stops of the joint that is calibrated to a whole turn; None for that.
    free_joint_stops_ticks: tuple[int, int] | None = None


WHOLE_TURN = 0, MAX_TICK

# Two printed parts of the SO-101's wrist meet there (lerobot, pull request 4583), whatever its calibration says.
WRIST_ROLL_STOPS = 113, 3981

FACTORY = Population()

# As lerobot leaves them when it disconnects (its so_follower.py): its registers, and the EPROM unlocked.
LEROBOT_CONFIGURED = Population(
    {**LEROBOT.registers, Register.RETURN_DELAY: 0},
    LEROBOT.gripper,
    unlocked=True,
    gripper_heating=SQUEEZING,
    free_joint_stops_ticks=WRIST_ROLL_STOPS,
)

# A driver for ROS 2 with homing offsets of its own in its YAML file (ros-physical-ai/feetech_ros2_driver): these are
# 8 to 18 deg from the calibrated ones.
ROS2_DRIVER = Population(
    limits_ticks=WHOLE_TURN,
    offset_shift_ticks=(91, -120, 204, -150, 100, 0),
    gripper_heating=SQUEEZING,
    free_joint_stops_ticks=WRIST_ROLL_STOPS,
)

# A compatible servo of 12 V under the model number of the STS3250, its firmware not the same throughout an arm.
CLONE = Population(
    {Register.MODEL_NUMBER: MODELS["sts3250"], Register.RETURN_DELAY: 250, Register.MAX_VOLTAGE: 140},
    firmware=(10, 10, 9, 10, 43, 10),
    powers_up_unlocked=True,
    powers_up_holding=True,
    overload_latches=True,
    supply_v=SUPPLY_12_V,
    gripper_heating=SQUEEZING,
    free_joint_stops_ticks=WRIST_ROLL_STOPS,
)

# New servos, each put into the arm as it came out of its box: the horns are where the encoders happened to stand.
KIT = Population(
    {Register.RETURN_DELAY: 250},
    servo_id=1,
    limits_ticks=WHOLE_TURN,
    has_offsets=False,
    horn_ticks=(120, -340, 260, -180, 410, 60),
)

POPULATIONS: Mapping[str, Population] = {
    "factory": FACTORY,
    "lerobot": LEROBOT_CONFIGURED,
    "ros2_driver": ROS2_DRIVER,
    "clone": CLONE,
    "kit": KIT,
}
