"""Emulated servos of both families, for tests of what they do alike."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from dynamixel_sdk import BROADCAST_ID

from robot.emulator.dynamixel import DYNAMIXEL as DYNAMIXEL_CODEC
from robot.emulator.dynamixel import DynamixelServo
from robot.emulator.feetech import FEETECH as FEETECH_CODEC
from robot.emulator.feetech import FeetechServo
from robot.emulator.plant import Plant
from robot.emulator.servo_bus import Codec
from robot.hardware.dynamixel import family as dynamixel_packets
from robot.hardware.dynamixel import registers as dynamixel_registers
from robot.hardware.dynamixel.registers import MODELS, TICKS_S_PER_VELOCITY_UNIT
from robot.hardware.feetech import bus as feetech_packets
from robot.hardware.feetech import registers as feetech_registers
from tests.helpers import emulator

IDS = (1, 2, 3)
ALL = BROADCAST_ID


@dataclass(frozen=True)
class Family:
    """What differs between the families.

    Attributes:
        codec: packets of the emulated servos.
        driver: module with the packets of the driver.
        registers: module with the registers.
        build: makes a servo with an id at an encoder position of 2048, far from its stops.
        build_packet: makes an instruction out of id, code and parameters.
        velocity: register of the velocity cap, and ticks/s of its unit.
        limit: register that limits the duty to a quarter, and its value.
        supply: register of the measured supply.
        stored: register that a power cut keeps.
    """

    codec: Codec
    driver: Any
    registers: Any
    build: Callable[[int], Any]
    build_packet: Callable[[int, int, bytes], bytes]
    velocity: tuple[str, float]
    limit: tuple[str, int]
    supply: str
    stored: str

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

    def word(self, value: int) -> bytes:
        """An address or a length among the parameters."""
        return value.to_bytes(self.codec.word_bytes, "little")

    def block(self, name: str) -> bytes:
        """Address and length of a register."""
        register = self.registers.Register[name]
        return self.word(register) + self.word(register.size)

    def assignment(self, name: str, value: int) -> bytes:
        """Parameters of a write."""
        register = self.registers.Register[name]
        encoded: bytes = register.encode(value)
        return self.word(register) + encoded


def run(servo: Any, duration_s: float) -> None:
    for _ in range(round(duration_s / 0.01)):
        servo.step(0.01)


def _plant() -> Plant:
    return Plant(2048.0, -20_000.0, 20_000.0)


FEETECH = Family(
    codec=FEETECH_CODEC,
    driver=feetech_packets,
    registers=feetech_registers,
    build=lambda servo: FeetechServo(_plant(), {feetech_registers.Register.ID: servo}),
    build_packet=emulator.packet,
    velocity=("GOAL_VELOCITY", 1.0),
    limit=("TORQUE_LIMIT", 250),
    supply="PRESENT_VOLTAGE",
    stored="MAX_TORQUE",
)
DYNAMIXEL = Family(
    codec=DYNAMIXEL_CODEC,
    driver=dynamixel_packets,
    registers=dynamixel_registers,
    build=lambda servo: DynamixelServo(servo, MODELS["xl330-m288"], _plant()),
    build_packet=dynamixel_packets.packet,
    velocity=("PROFILE_VELOCITY", TICKS_S_PER_VELOCITY_UNIT),
    limit=("GOAL_PWM", 221),
    supply="PRESENT_INPUT_VOLTAGE",
    stored="PWM_LIMIT",
)
OF_BOTH_FAMILIES = pytest.mark.parametrize("family", [FEETECH, DYNAMIXEL], ids=["Feetech", "Dynamixel"])
