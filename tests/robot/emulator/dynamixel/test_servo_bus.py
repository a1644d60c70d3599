from __future__ import annotations

import pytest
from dynamixel_sdk import INST_PING, INST_READ, INST_REBOOT, INST_SYNC_READ, INST_WRITE

from robot.emulator.dynamixel.servo import REBOOT_S, DynamixelServo
from robot.emulator.dynamixel.servo_bus import (
    CRC_ERROR,
    INSTRUCTION_ERROR,
    PARTIAL_PACKET_S,
    DynamixelBus,
    InstructionParser,
    status_packet,
)
from robot.emulator.faults import Faults
from robot.emulator.plant import Plant
from robot.hardware.dynamixel.packets import ALERT, block_parameters, packet
from robot.hardware.dynamixel.registers import MODELS, Register, encode

ALL = 254


@pytest.fixture
def bus() -> DynamixelBus:
    servos = [DynamixelServo(servo, MODELS["xl330-m288"], Plant(1000.0 * servo, 0.0, 4095.0)) for servo in (1, 2, 3)]
    return DynamixelBus(servos, Faults(), 0.0)


def read_packet(servo: int, register: Register, length: int) -> bytes:
    return packet(servo, INST_READ, bytes(block_parameters(register, length)))


def write_packet(servo: int, register: Register, value: int) -> bytes:
    return packet(servo, INST_WRITE, register.to_bytes(2, "little") + encode(register, value))


def test_a_hardware_error_raises_the_alert_of_every_reply(bus: DynamixelBus) -> None:
    bus.servos[1].fail(0x01)
    assert bus.receive(read_packet(2, Register.LED, 1), 0.0) == status_packet(2, ALERT, b"\x00")
    assert bus.receive(write_packet(2, Register.GOAL_PWM, 886), 0.0) == status_packet(2, ALERT | 6)


@pytest.mark.parametrize(("stalls", "answering"), [(False, 2), (True, 1)])
def test_a_missing_servo_may_silence_those_behind_it(bus: DynamixelBus, stalls: bool, answering: int) -> None:
    bus.faults.offline, bus.faults.stall_behind_missing = {2}, stalls
    request = packet(ALL, INST_SYNC_READ, bytes([*block_parameters(Register.LED, 1), 1, 2, 3]))
    assert len(bus.receive(request, 0.0)) == answering * len(status_packet(1, 0, b"\0"))


def test_a_broadcast_write_is_taken_by_all_and_answered_by_nobody(bus: DynamixelBus) -> None:
    assert bus.receive(write_packet(ALL, Register.LED, 1), 0.0) == b""
    assert [servo.value(Register.LED) for servo in bus.servos] == [1, 1, 1]


def test_a_rebooted_servo_is_silent_for_a_while(bus: DynamixelBus) -> None:
    assert bus.receive(packet(2, INST_REBOOT), 0.0) == status_packet(2, 0)
    assert bus.receive(packet(2, INST_PING), 0.5 * REBOOT_S) == b""
    assert bus.receive(packet(2, INST_PING), 1.1 * REBOOT_S) != b""


def test_an_unknown_instruction_is_an_instruction_error(bus: DynamixelBus) -> None:
    assert bus.receive(packet(2, 0x92, b"\x01"), 0.0) == status_packet(2, INSTRUCTION_ERROR)


def test_a_damaged_instruction_is_a_crc_error_and_does_nothing(bus: DynamixelBus) -> None:
    damaged = bytearray(write_packet(2, Register.LED, 1))
    damaged[10] ^= 0xFF
    assert bus.receive(bytes(damaged), 0.0) == status_packet(2, CRC_ERROR)
    assert bus.servos[1].value(Register.LED) == 0


def test_a_servo_answers_no_more_than_its_status_return_level_says(bus: DynamixelBus) -> None:
    bus.receive(write_packet(2, Register.STATUS_RETURN_LEVEL, 1), 0.0)
    assert bus.receive(write_packet(2, Register.LED, 1), 0.0) == b""
    assert bus.receive(read_packet(2, Register.LED, 1), 0.0) != b""
    bus.receive(write_packet(2, Register.STATUS_RETURN_LEVEL, 0), 0.0)
    assert bus.receive(read_packet(2, Register.LED, 1), 0.0) == b""
    assert bus.receive(packet(2, INST_PING), 0.0) != b""


def test_a_packet_may_come_in_pieces_but_not_long_after_each_other() -> None:
    parser, whole = InstructionParser(), packet(2, INST_PING)
    assert parser.feed(whole[:4], 0.0) == []
    assert len(parser.feed(whole[4:], 0.001)) == 1
    assert parser.feed(whole[:4], 0.002) == []
    assert parser.feed(whole[4:], 0.003 + PARTIAL_PACKET_S) == []
    assert len(parser.feed(b"\xff\xff" + whole + whole, 0.004 + PARTIAL_PACKET_S)) == 2


def test_every_instruction_on_the_bus_feeds_every_watchdog(bus: DynamixelBus) -> None:
    for servo in bus.servos:
        servo.hold()
    bus.receive(write_packet(ALL, Register.BUS_WATCHDOG, 5), 0.0)
    for tick in range(1, 50):
        bus.receive(read_packet(1, Register.LED, 1), 0.01 * tick)
    assert [servo.value(Register.BUS_WATCHDOG) for servo in bus.servos] == [5, 5, 5]
    bus.advance(1.0)
    assert [servo.value(Register.BUS_WATCHDOG) for servo in bus.servos] == [-1, -1, -1]


def test_lost_instructions_and_replies_are_lost(bus: DynamixelBus) -> None:
    bus.faults.lose_instruction = 1.0
    assert bus.receive(write_packet(2, Register.LED, 1), 0.0) == b""
    assert bus.servos[1].value(Register.LED) == 0
    bus.faults.lose_instruction, bus.faults.drop = 0.0, 1.0
    assert bus.receive(write_packet(2, Register.LED, 1), 0.0) == b""
    assert bus.servos[1].value(Register.LED) == 1
