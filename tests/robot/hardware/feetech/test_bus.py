from __future__ import annotations

import contextlib

import pytest
from scservo_sdk import BROADCAST_ID, INST_WRITE

from robot.emulator.feetech import FEETECH
from robot.errors import NoReply
from robot.hardware.feetech.bus import (
    READ_LENGTHS,
    SYNC_READ_MIN_LENGTH,
    SYNC_READ_PADDINGS,
)
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    encode,
    parse_telemetry,
)
from robot.hardware.port import QUIET_S
from robot.hardware.servos.bus import ATTEMPTS
from tests.helpers.bad_lines import IDS, good_readings_on_a_bad_line, halting_for, honest, read_telemetry, value_of
from tests.helpers.scripted_servos import ScriptedPort

# On the emulated arm.


def test_the_same_data_can_be_written_elsewhere_and_other_data_there(bus):
    for limit in (300, 400):
        data = {1: encode(Register.TORQUE_LIMIT, limit)}
        bus.sync_write(Register.TORQUE_LIMIT, data)
        bus.sync_write(Register.GOAL_POSITION, data)
        assert (bus.read(1, Register.TORQUE_LIMIT), bus.read(1, Register.GOAL_POSITION)) == (limit, limit)


def test_readings_of_servos_at_rest_are_reused_and_one_that_moved_is_read(bus, emulator):
    before = read_telemetry(bus)
    assert read_telemetry(bus) is before
    emulator.command(jump={"3": 40})
    after = read_telemetry(bus)
    moved = [
        parse_telemetry(after[i].data).position_ticks - parse_telemetry(before[i].data).position_ticks for i in IDS
    ]
    assert moved == [0, 0, 40, 0, 0, 0]


def test_a_broadcast_ping_finds_those_who_are_there(bus, emulator):
    emulator.command(offline=[2])
    assert bus.broadcast_ping() == dict.fromkeys([1, 3, 4, 5, 6], 0)
    assert bus.read(3, Register.MODEL_NUMBER) == 777


# On a line where every byte is scripted.


def test_the_error_byte_of_a_reply_is_kept_and_its_data_believed():
    def overloaded(instruction):
        return [
            (0.0, FEETECH.status_packet(i, 32, bytes(instruction.parameters[1]))) for i in instruction.parameters[2:]
        ]

    bus = ScriptedPort(overloaded).open_bus()
    assert [frame.error for frame in read_telemetry(bus).values()] == [32] * 6


def test_a_burst_may_stop_for_as_long_as_usb_does():
    assert len(read_telemetry(ScriptedPort(halting_for(0.9 * QUIET_S)).open_bus())) == 6


def test_a_burst_that_stops_for_longer_has_ended():
    line = ScriptedPort(halting_for(1.5 * QUIET_S))
    assert list(read_telemetry(line.open_bus())) == [1]


def test_a_silent_line_is_asked_three_times_and_then_reported():
    line = ScriptedPort(lambda _instruction: [])
    started_s = line.clock()
    bus = line.open_bus()
    with pytest.raises(NoReply, match=r"servo 4 .* 3 instructions"):
        bus.read(4, Register.PRESENT_POSITION)
    assert (bus.counters.sent, bus.counters.timeouts, bus.counters.retries) == (ATTEMPTS, ATTEMPTS, 2)
    assert len(line.instructions) == ATTEMPTS
    assert line.clock() - started_s < ATTEMPTS * 0.01


def test_no_two_single_reads_in_a_row_ask_for_the_same_length():
    line = ScriptedPort(honest)
    bus = line.open_bus()
    for _ in range(len(READ_LENGTHS)):
        bus.read(1, Register.PRESENT_TEMPERATURE)
    lengths = [instruction.parameters[1] for instruction in line.instructions]
    assert len(set(lengths)) == len(READ_LENGTHS)
    assert max(lengths) < SYNC_READ_MIN_LENGTH


def test_a_late_reply_is_not_taken_for_the_answer_to_the_next_question():
    def late_once(instruction):
        first = len(line.instructions) == 1
        return [(0.06 if first else 0.0, data) for _, data in honest(instruction)]

    line = ScriptedPort(late_once)
    with contextlib.closing(line.open_bus()) as bus:
        readings = []
        for register in (Register.PRESENT_TEMPERATURE, Register.PRESENT_VOLTAGE, Register.STATUS) * 4:
            with contextlib.suppress(NoReply):
                readings.append(bus.read(1, register) == value_of(1, register))
    assert readings
    assert all(readings)


def test_a_sync_read_after_a_late_one_asks_for_another_length():
    def stale_block(instruction):
        late = len(line.instructions) == 1
        data = bytes([len(line.instructions)] * instruction.parameters[1])
        return [(0.012 * late, FEETECH.status_packet(i, 0, data)) for i in instruction.parameters[2:]]

    line = ScriptedPort(stale_block)
    bus = line.open_bus()
    assert read_telemetry(bus) == {}
    for expected in (2, 3):
        for frame in read_telemetry(bus).values():
            assert frame.data == bytes([expected] * TELEMETRY_BYTES)


def test_blocks_of_different_length_never_ask_for_the_same_number_of_bytes():
    line = ScriptedPort(lambda _instruction: [])
    bus = line.open_bus()
    for _ in range(SYNC_READ_PADDINGS):
        bus.sync_read((1,), CONTROL_ADDRESS, CONTROL_BYTES)
        read_telemetry(bus)
    asked = [(instruction.parameters[0], instruction.parameters[1]) for instruction in line.instructions]
    control = {length for address, length in asked if address == CONTROL_ADDRESS}
    telemetry = {length for address, length in asked if address == TELEMETRY_ADDRESS}
    assert not control & telemetry


def test_after_a_failure_nothing_is_sent_until_the_line_is_quiet():
    heard = []

    def talkative(instruction):
        heard.append(line.clock())
        if len(heard) > 1:
            return honest(instruction)
        return [(0.002 * k, b"\x00noise") for k in range(8)]

    line = ScriptedPort(talkative)
    assert line.open_bus().read(1, Register.PRESENT_VOLTAGE) == value_of(1, Register.PRESENT_VOLTAGE)
    assert heard[1] - heard[0] == pytest.approx(0.014 + QUIET_S)


def test_endless_noise_ends_in_no_reply_and_not_in_a_hang():
    line = ScriptedPort(lambda _instruction: [(0.0005 * k, bytes(64)) for k in range(4000)])
    started_s = line.clock()
    with pytest.raises(NoReply):
        line.open_bus().read(1, Register.PRESENT_VOLTAGE)
    assert line.clock() - started_s < 0.2


def test_the_emergency_stop_does_not_wait_for_a_noisy_line():
    line = ScriptedPort(lambda _instruction: [(0.0005 * k, bytes(64)) for k in range(40)])
    bus = line.open_bus()
    read_telemetry(bus)
    started_s = line.clock()
    bus.broadcast_torque_off()
    assert line.clock() == started_s
    assert (line.instructions[-1].servo_id, line.instructions[-1].code) == (BROADCAST_ID, INST_WRITE)


def test_no_reading_marked_good_is_wrong_whatever_the_line_does():
    for seed in range(30):
        assert good_readings_on_a_bad_line(ScriptedPort, seed) > 25, seed
