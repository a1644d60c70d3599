"""What differs between the families of servos, for tests of what servos of every family do alike."""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pytest

from robot.calibration import Calibration
from robot.emulator.dynamixel import DYNAMIXEL as DYNAMIXEL_CODEC
from robot.emulator.dynamixel import DynamixelServo
from robot.emulator.feetech import FEETECH as FEETECH_CODEC
from robot.emulator.feetech import FeetechServo
from robot.emulator.plant import Plant
from robot.emulator.servo_bus import Codec
from robot.hardware.dynamixel import family as dynamixel_packets
from robot.hardware.dynamixel import registers as dynamixel_registers
from robot.hardware.feetech import bus as feetech_packets
from robot.hardware.feetech import registers as feetech_registers
from robot.hardware.feetech.family import Feetech
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.bus import StatusFrame
from robot.hardware.servos.family import ServoFamily, ServoMap
from tests.helpers import arm_rig, dynamixel, emulator
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
        rig: kind of a supervisor on the emulated servos.
        fail: makes a servo report an overload.
        limit: torque limit of a servo [share].
        lowest_limit: register of the lower angle limit.
        codec: packets of the emulated servos.
        packets: module with the packets of the driver.
        build: makes a servo with an id at an encoder position of 2048, far from its stops.
        build_packet: makes an instruction out of id, code and parameters.
        velocity: register of the velocity cap, and ticks/s of its unit.
        quarter: register that limits the duty to a quarter, and its value.
        supply: register of the measured supply.
        stored: register that a power cut keeps.
    """

    driver: ServoFamily
    calibration: Calibration
    bounds: Any
    registers: Any
    frame: Callable[[int, int], StatusFrame]
    start: Callable[[Mapping[str, float]], Any]
    in_use: Any
    rig: Any
    fail: Callable[[Any], object]
    limit: Callable[[Any], float]
    lowest_limit: str
    codec: Codec
    packets: Any
    build: Callable[[int], Any]
    build_packet: Callable[[int, int, bytes], bytes]
    velocity: tuple[str, float]
    quarter: tuple[str, int]
    supply: str
    stored: str

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
        self.write(emulator.servo_bus.servos[servo - 1], name, value)

    def limits(self, emulator: Any) -> list[float]:
        return [self.limit(servo) for servo in emulator.servo_bus.servos]

    def read(self, servo: Any, name: str) -> int:
        """A register as a host reads it."""
        register = self.registers.Register[name]
        value: int = register.decode(servo.read(register, register.size))
        return value

    def write(self, servo: Any, name: str, value: int) -> int:
        """Write a register as a host does; returns the error, 0 for none."""
        register = self.registers.Register[name]
        error: int = servo.write(register, register.encode(value))
        return error

    def block(self, name: str) -> bytes:
        """Address and length of a register."""
        register, size = self.registers.Register[name], self.codec.word_bytes
        return register.to_bytes(size, "little") + register.size.to_bytes(size, "little")

    def assignment(self, name: str, value: int) -> bytes:
        """Parameters of a write."""
        register = self.registers.Register[name]
        encoded: bytes = register.encode(value)
        return register.to_bytes(self.codec.word_bytes, "little") + encoded


def run(servo: Any, duration_s: float) -> None:
    for _ in range(round(duration_s / 0.01)):
        servo.step(0.01)


def _feetechs(start_rad: Mapping[str, float]) -> SteppedEmulator:
    pose = (str(start_rad.get(name, 0.0)) for name in arm_rig.NAMES)
    return SteppedEmulator("--start", ",".join(pose))


def _plant() -> Plant:
    return Plant(2048.0, -20_000.0, 20_000.0)


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
    rig=ArmRig,
    fail=lambda servo: setattr(servo.protection, "latched", StatusFlag.OVERLOAD),
    limit=lambda servo: servo.value(feetech_registers.Register.TORQUE_LIMIT) / 1000.0,
    lowest_limit="MIN_ANGLE_LIMIT",
    codec=FEETECH_CODEC,
    packets=feetech_packets,
    build=lambda servo: FeetechServo(_plant(), {feetech_registers.Register.ID: servo}),
    build_packet=emulator.packet,
    velocity=("GOAL_VELOCITY", 1.0),
    quarter=("TORQUE_LIMIT", 250),
    supply="PRESENT_VOLTAGE",
    stored="MAX_TORQUE",
)
DYNAMIXEL = Family(
    driver=dynamixel_packets.Dynamixel(),
    calibration=dynamixel.CALIBRATION,
    bounds=dynamixel.BOUNDS,
    registers=dynamixel_registers,
    frame=lambda servo, ticks: StatusFrame(servo, 0, struct.pack("<hhiiiiHB", -443, 350, 10, ticks, 0, 0, 118, 41)),
    start=lambda start_rad: SteppedDynamixels(start_rad=start_rad),
    in_use=DynamixelsInUse,
    rig=DynamixelRig,
    fail=lambda servo: servo.fail(0x20),
    limit=lambda servo: servo._drive.torque_permille / 1000.0,
    lowest_limit="MIN_POSITION_LIMIT",
    codec=DYNAMIXEL_CODEC,
    packets=dynamixel_packets,
    build=lambda servo: DynamixelServo(servo, dynamixel_registers.MODELS["xl330-m288"], _plant()),
    build_packet=dynamixel_packets.packet,
    velocity=("PROFILE_VELOCITY", dynamixel_registers.TICKS_S_PER_VELOCITY_UNIT),
    quarter=("GOAL_PWM", 221),
    supply="PRESENT_INPUT_VOLTAGE",
    stored="PWM_LIMIT",
)
FAMILIES = {"Feetech": FEETECH, "Dynamixel": DYNAMIXEL}
OF_BOTH_FAMILIES = pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
