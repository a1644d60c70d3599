"""Scripted servos that are well, or whose replies are lost, late, damaged or of others; and reading from them."""

import contextlib
import random
from collections.abc import Callable
from typing import Any

from scservo_sdk import INST_PING, INST_READ, INST_SYNC_READ, INST_WRITE

from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Instruction
from robot.errors import NoReply
from robot.hardware.feetech.bus import Bus, StatusFrame
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES, Register
from tests.helpers.scripted_servos import Script

IDS = (1, 2, 3, 4, 5, 6)


def read_telemetry(bus: Bus) -> dict[int, StatusFrame]:
    return bus.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES)


def value_of(servo_id: int, register: Register) -> int:
    """A value that no other servo and no other register has."""
    return (servo_id * 37 + register * 5) % 256 if register.size == 1 else servo_id * 150 + register


def memory_of(servo_id: int, address: int, length: int) -> bytes:
    """Bytes of a register of the scripted servo, followed by bytes that no test checks."""
    return Register(address).encode(value_of(servo_id, Register(address))).ljust(length, b"\x55")


def honest(instruction: Instruction) -> list[tuple[float, bytes]]:
    """The reply of a servo that is well."""
    code, parameters = instruction.code, instruction.parameters
    if code == INST_READ:
        data = memory_of(instruction.servo_id, *parameters)
        return [(0.0, FEETECH.status_packet(instruction.servo_id, 0, data))]
    if code in (INST_PING, INST_WRITE):
        return [(0.0, FEETECH.status_packet(instruction.servo_id, 0))]
    return []


def halting_for(pause_s: float) -> Script:
    """Servos whose replies stop once in between."""

    def halting(instruction: Instruction) -> list[tuple[float, bytes]]:
        length, *ids = instruction.parameters[1:]
        return [(pause_s * (i > 1), FEETECH.status_packet(i, 0, bytes(length))) for i in ids]

    return halting


def good_readings_on_a_bad_line(start_line: Callable[[Script], Any], seed: int) -> int:
    """Every reply may be lost, late, cut, corrupted, repeated, of another servo, or in noise."""
    questions, chance = random.Random(seed), random.Random(seed + 100)

    def damaged(packet: bytes) -> list[tuple[float, bytes]]:
        delay = chance.choice([0.0, 0.0, 0.0, 0.001, 0.006, 0.04])
        at = chance.randrange(len(packet))
        match chance.randrange(28):
            case 0:
                return []
            case 1:
                return [(delay, packet[:at])]
            case 2:
                return [(delay, packet[:at] + bytes([packet[at] ^ chance.randrange(1, 256)]) + packet[at + 1 :])]
            case 3:
                return [(delay, packet + packet)]
            case 4:
                return [(0.0, packet), (delay, packet)]
            case 5:
                return [(delay, FEETECH.status_packet(9, 0, packet[5:-1]) + packet)]
            case 6:
                return [(delay, chance.randbytes(chance.randrange(20)) + packet)]
            case 7:
                return [(delay, packet)]
        return [(0.0, packet)]

    def peer_of(instruction: Instruction) -> list[tuple[float, bytes]]:
        if instruction.code == INST_SYNC_READ:
            stamp = len(line.instructions) % 250
            replies = [FEETECH.status_packet(i, 0, bytes([stamp, i] * 12)[: instruction.parameters[1]]) for i in IDS]
        else:
            replies = [data for _, data in honest(instruction)]
        return [scripted for packet in replies for scripted in damaged(packet)]

    line = start_line(peer_of)
    good = 0
    with contextlib.closing(line.open_bus()) as bus:
        for _ in range(40):
            servo_id = questions.choice(IDS)
            register = questions.choice(list(Register))
            with contextlib.suppress(NoReply):
                assert bus.read(servo_id, register) == value_of(servo_id, register)
                good += 1
            for sync_id, frame in read_telemetry(bus).items():
                stamp = len(line.instructions) % 250
                assert frame.data == bytes([stamp, sync_id] * 8)[:TELEMETRY_BYTES]
                good += 1
    return good
