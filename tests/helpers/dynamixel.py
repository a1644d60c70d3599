"""Emulated Dynamixel servos of a Koch v1.1 in the test's own process and time, and a supervisor on them."""

from functools import partial
from typing import Any, cast

from robot.calibration import Calibration, JointCalibration
from robot.description import robot_folder
from robot.description.limits import JointBounds, within_calibration
from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm
from robot.emulator.dynamixel import DynamixelServo, emulated_dynamixel_arm
from robot.emulator.feetech import emulated_feetech_arm
from robot.hardware.config import EmulatedConfig, SerialConfig
from robot.hardware.dynamixel.family import Bus, Dynamixel
from robot.hardware.dynamixel.registers import Register
from robot.messages import GuardLimits
from tests.helpers import arm_rig
from tests.helpers.arm_rig import ArmRig, ServosInUse
from tests.helpers.emulator import SteppedClock
from tests.helpers.robots import so101

KOCH = robot_folder.built_in("koch_v1_1")
SERVOS = KOCH.hardware.servos
NAMES = tuple(servo.joint for servo in SERVOS)

# As lerobot writes one: offsets anywhere within half a turn, the two joints that turn freely with all ticks.
_OFFSETS_AND_RANGES = (
    (-300, 0, 4095),
    (900, 1300, 2790),
    (-1700, 1020, 3080),
    (2000, 780, 3310),
    (0, 0, 4095),
    (120, 1900, 3000),
)
CALIBRATION = Calibration(
    tuple(
        JointCalibration(servo, servo.servo_id, 0, *numbers)
        for servo, numbers in zip(SERVOS, _OFFSETS_AND_RANGES, strict=True)
    )
)
ROBOT = within_calibration(KOCH.model, CALIBRATION)
BOUNDS = JointBounds.of(ROBOT, NAMES)
METAL = SerialConfig(CALIBRATION, "/dev/arm", "dynamixel")


def emulated_arm(kind: str, clock: SteppedClock, robot: RobotModel | None = None, **settings: Any) -> EmulatedArm[Any]:
    """Build the emulated servos of a Koch, or those of an SO-101 for the kind "feetech"."""
    if kind == "dynamixel":
        config = EmulatedConfig(CALIBRATION, kind=kind, **settings)
        return emulated_dynamixel_arm(ROBOT, config, BOUNDS, GuardLimits(), clock)
    config = EmulatedConfig(arm_rig.CALIBRATION, **settings)
    return emulated_feetech_arm(robot or so101(), config, arm_rig.BOUNDS, GuardLimits(), clock)


class SteppedDynamixels:
    """Emulated servos at the other end of an in-process port."""

    def __init__(self, **settings: Any) -> None:
        self.clock = SteppedClock()
        self.config = EmulatedConfig(kind="dynamixel", **{"calibration": CALIBRATION, **settings})
        self.source = emulated_dynamixel_arm(ROBOT, self.config, BOUNDS, GuardLimits(), self.clock)
        self.servo_bus = self.source.bus
        self.port = self.source.port

    def servo(self, servo_id: int) -> DynamixelServo:
        return next(servo for servo in self.servo_bus.servos if servo.servo_id == servo_id)

    def open_bus(self) -> Bus:
        """The host's end of the wire."""
        return Bus(self.port, self.clock)

    def run(self, seconds: float) -> None:
        """Let the servos move on their own; also serves as a wait."""
        until_s = self.clock() + seconds
        while (left_s := until_s - self.clock()) > 0.0:
            self.clock.advance(min(left_s, 0.01))
            self.servo_bus.advance(self.clock())

    def registers(self, register: Register) -> list[int]:
        """A register of every servo, read without the bus."""
        return [servo.value(register) for servo in self.servo_bus.servos]

    def writes(self) -> int:
        """Number of writes that the servos have accepted."""
        return sum(servo.writes for servo in self.servo_bus.servos)


unread_hardware = partial(arm_rig.unread_hardware, config=METAL, family=Dynamixel, bounds=BOUNDS)


class DynamixelsInUse(ServosInUse):
    """Hardware that takes emulated servos for real ones."""

    def __init__(self, emulator: SteppedDynamixels | None = None, config: SerialConfig = METAL) -> None:
        emulator = emulator or SteppedDynamixels()
        super().__init__(emulator, unread_hardware(emulator, config=config))

    def hold_for(self, seconds: float) -> None:
        """Tick as the controller does while it holds: the goals are written again and again."""
        goal_rad = self.read().position_rad
        for _ in range(round(seconds / 0.01)):
            self.read()
            self.hardware.write_goals(goal_rad)


class DynamixelRig(ArmRig):
    """A supervisor on emulated servos, which it takes for real ones unless ``hardware`` says otherwise."""

    _unread = staticmethod(unread_hardware)

    def __init__(self, dynamixels: SteppedDynamixels | None = None, **settings: Any) -> None:
        self.dynamixels = dynamixels or SteppedDynamixels()
        settings = {"robot": ROBOT, "hardware": METAL, **settings}
        super().__init__(cast("Any", self.dynamixels), **settings)

    def torque(self) -> list[int]:
        """Register TORQUE_ENABLE of every servo."""
        return self.dynamixels.registers(Register.TORQUE_ENABLE)
