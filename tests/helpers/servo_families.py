"""What differs between the families of servos, for tests of what servos of every family do alike."""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from robot.calibration import Calibration
from robot.hardware.dynamixel import registers as dynamixel_registers
from robot.hardware.dynamixel.family import Dynamixel
from robot.hardware.feetech import registers as feetech_registers
from robot.hardware.feetech.family import Feetech
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.bus import StatusFrame
from robot.hardware.servos.family import ServoFamily, ServoMap
from tests.helpers import arm_rig, dynamixel
from tests.helpers.arm_rig import ArmRig, FeetechsInUse
from tests.helpers.dynamixel import DynamixelRig, DynamixelsInUse, SteppedDynamixels
from tests.helpers.emulator import SteppedEmulator

IDS = (1, 2, 3, 4, 5, 6)


@dataclass(frozen=True)
class Family:
    """One family, and its emulated servos.

    Attributes:
        driver: the family as the driver has it.
        calibration: of the arm.
        bounds: of its joints.
        registers: module with ``Register`` and ``encode``.
        frame: reply of a servo that stands somewhere.
        start: makes emulated servos at a pose [rad].
        in_use: kind of the hardware that was found and read once.
        unread: makes hardware that was not read.
        rig: kind of a supervisor on the emulated servos.
        fail: makes a servo report an overload.
        limit: torque limit of a servo [share].
        lowest_limit: register of the lower angle limit.
    """

    driver: ServoFamily
    calibration: Calibration
    bounds: Any
    registers: Any
    frame: Callable[[int, int], StatusFrame]
    start: Callable[[Mapping[str, float]], Any]
    in_use: Any
    unread: Any
    rig: Any
    fail: Callable[[Any], object]
    limit: Callable[[Any], float]
    lowest_limit: str

    @property
    def servo_map(self) -> ServoMap:
        return ServoMap(self.driver, self.calibration, self.bounds)

    def emulator(self, **start_rad: float) -> Any:
        return self.start(start_rad)

    def value(self, emulator: Any, servo: int, name: str) -> int:
        """A register of an emulated servo, read without the bus."""
        value: int = emulator.servo_bus.servos[servo - 1].value(self.registers.Register[name])
        return value

    def values(self, emulator: Any, name: str) -> list[int]:
        return [self.value(emulator, servo, name) for servo in IDS]

    def put(self, emulator: Any, servo: int, name: str, value: int) -> None:
        """Write a register of an emulated servo without the bus."""
        register = self.registers.Register[name]
        emulator.servo_bus.servos[servo - 1].write(register, register.encode(value))

    def limits(self, emulator: Any) -> list[float]:
        return [self.limit(servo) for servo in emulator.servo_bus.servos]


def _feetechs(start_rad: Mapping[str, float]) -> SteppedEmulator:
    pose = (str(start_rad.get(name, 0.0)) for name in arm_rig.NAMES)
    return SteppedEmulator("--start", ",".join(pose))


FEETECH = Family(
    driver=Feetech(),
    calibration=arm_rig.CALIBRATION,
    bounds=arm_rig.BOUNDS,
    registers=feetech_registers,
    frame=lambda servo, ticks: StatusFrame(
        servo, 0, feetech_registers.Register.PRESENT_POSITION.encode(ticks).ljust(15, b"\0")
    ),
    start=_feetechs,
    in_use=FeetechsInUse,
    unread=arm_rig.unread_hardware,
    rig=ArmRig,
    fail=lambda servo: setattr(servo.protection, "latched", StatusFlag.OVERLOAD),
    limit=lambda servo: servo.value(feetech_registers.Register.TORQUE_LIMIT) / 1000.0,
    lowest_limit="MIN_ANGLE_LIMIT",
)
DYNAMIXEL = Family(
    driver=Dynamixel(),
    calibration=dynamixel.CALIBRATION,
    bounds=dynamixel.BOUNDS,
    registers=dynamixel_registers,
    frame=lambda servo, ticks: StatusFrame(servo, 0, struct.pack("<hhiiiiHB", -443, 350, 10, ticks, 0, 0, 118, 41)),
    start=lambda start_rad: SteppedDynamixels(start_rad=start_rad),
    in_use=DynamixelsInUse,
    unread=dynamixel.unread_hardware,
    rig=DynamixelRig,
    fail=lambda servo: servo.fail(0x20),
    limit=lambda servo: servo._drive.torque_permille / 1000.0,
    lowest_limit="MIN_POSITION_LIMIT",
)
FAMILIES = {"Feetech": FEETECH, "Dynamixel": DYNAMIXEL}
