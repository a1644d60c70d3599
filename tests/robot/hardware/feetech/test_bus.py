import contextlib
import random
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scservo_sdk import BROADCAST_ID, INST_PING, INST_READ, INST_SYNC_READ, INST_WRITE

from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Codec, Instruction, InstructionParser
from robot.errors import NoReply
from robot.hardware.feetech import registers
from robot.hardware.feetech.bus import (
    MAX_INSTRUCTION_BYTES,
    READ_LENGTHS,
    SYNC_READ_MIN_LENGTH,
    SYNC_READ_PADDINGS,
    Bus,
    StatusFrame,
    checksum,
    instruction_packet,
    parse_status_frames,
)
from robot.hardware.feetech.registers import TELEMETRY, Register, parse_telemetry
from robot.hardware.interface import status_names
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S
from robot.hardware.servos.bus import ATTEMPTS, read_registers
from tests.helpers.arm_rig import run
from tests.helpers.emulator import SteppedClock

IDS = (1, 2, 3, 4, 5, 6)


def read_telemetry(bus: Bus) -> dict[int, StatusFrame]:
    return bus.sync_read(IDS, TELEMETRY.address, TELEMETRY.length)


def test_the_same_data_can_be_written_elsewhere_and_the_settings_are_the_registers_below_the_ram(bus):
    for limit in (300, 400):
        data = {1: Register.TORQUE_LIMIT.encode(limit)}
        bus.sync_write(Register.TORQUE_LIMIT, data)
        bus.sync_write(Register.GOAL_POSITION, data)
        assert (bus.read(1, Register.TORQUE_LIMIT), bus.read(1, Register.GOAL_POSITION)) == (limit, limit)
    bus.write(3, Register.HOMING_OFFSET, -1234)
    settings = {register: bus.read(3, register) for register in registers.SETTINGS}
    assert run(read_registers(bus, 3, registers.SETTINGS_BLOCK)) == settings
    # An identity cannot be written.
    identity = {Register.FIRMWARE_MAJOR, Register.FIRMWARE_MINOR, Register.MODEL_NUMBER}
    assert set(settings) - set(registers.EPROM) == identity


def test_readings_at_rest_are_reused_one_that_moved_is_read_and_a_broadcast_ping_finds_who_is_there(bus, emulator):
    before = read_telemetry(bus)
    assert read_telemetry(bus) is before
    emulator.command(jump={"3": 40})
    ticks = [[parse_telemetry(each[i].data).position_ticks for i in IDS] for each in (before, read_telemetry(bus))]
    assert np.subtract(ticks[1], ticks[0]).tolist() == [0, 0, 40, 0, 0, 0]
    emulator.command(offline=[2])
    assert bus.broadcast_ping() == dict.fromkeys([1, 3, 4, 5, 6], 0)
    assert bus.read(3, Register.MODEL_NUMBER) == 777


# What a far end says to an instruction: bytes, and how long after the instruction they come [s]. Bytes leave in the
# order in which they were scripted, as they would pass one wire: a late one holds up those behind it.
Script = Callable[[Instruction], list[tuple[float, bytes]]]


class ScriptedPort:
    """A :class:`robot.hardware.port.BusPort` with a script; who waits for its bytes moves the clock."""

    def __init__(self, script: Script, codec: Codec = FEETECH) -> None:
        self.script = script
        self.clock = SteppedClock()
        self.instructions: list[Instruction] = []
        self.port_name = "scripted"
        self.baudrate = 1_000_000
        self.is_using = False
        self.latency_s, self.quiet_s = LOCAL_LATENCY_S, QUIET_S
        self.discarded_bytes = 0
        self._parser = InstructionParser(codec)
        self._outbox: deque[tuple[float, bytes]] = deque()

    def open_bus(self) -> Bus:
        return Bus(self, self.clock)

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        self.discarded_bytes += len(self._arrived())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        for instruction in self._parser.feed(bytes(packet), self.clock()):
            self.instructions.append(instruction)
            for delay_s, data in self.script(instruction):
                last_due_s = self._outbox[-1][0] if self._outbox else 0.0
                self._outbox.append((max(last_due_s, self.clock() + delay_s), data))
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:
        data = self._arrived()
        if not data and timeout_s > 0.0:
            due_s = self._outbox[0][0] if self._outbox else float("inf")
            self.clock.advance(min(timeout_s, due_s - self.clock()))
            data = self._arrived()
        return data

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        self._outbox.clear()

    def _arrived(self) -> bytes:
        data = b""
        while self._outbox and self._outbox[0][0] <= self.clock():
            data += self._outbox.popleft()[1]
        return data


def value_of(servo_id: int, register: Register) -> int:
    """A value that no other servo and no other register has."""
    return (servo_id * 37 + register * 5) % 256 if register.size == 1 else servo_id * 150 + register


def honest(instruction: Instruction) -> list[tuple[float, bytes]]:
    """The reply of a servo that is well; no test checks the bytes behind a register."""
    if instruction.code == INST_READ:
        address, length = instruction.parameters
        data = Register(address).encode(value_of(instruction.servo_id, Register(address))).ljust(length, b"\x55")
        return [(0.0, FEETECH.status_packet(instruction.servo_id, 0, data))]
    if instruction.code in (INST_PING, INST_WRITE):
        return [(0.0, FEETECH.status_packet(instruction.servo_id, 0))]
    return []


def replying(pause_s: float = 0.0, error: int = 0) -> Script:
    """Servos that answer a sync read, with a pause after the first reply."""

    def reply(instruction: Instruction) -> list[tuple[float, bytes]]:
        length, *ids = instruction.parameters[1:]
        return [(pause_s * (i > 1), FEETECH.status_packet(i, error, bytes(length))) for i in ids]

    return reply


def test_replies_keep_their_error_byte_and_may_stop_for_as_long_as_usb_does():
    frames = read_telemetry(ScriptedPort(replying(error=32)).open_bus())
    assert [frame.error for frame in frames.values()] == [32] * 6
    assert len(read_telemetry(ScriptedPort(replying(0.9 * QUIET_S)).open_bus())) == 6
    assert list(read_telemetry(ScriptedPort(replying(1.5 * QUIET_S)).open_bus())) == [1]


@pytest.mark.parametrize("latency_s", [LOCAL_LATENCY_S, 0.2])
def test_a_broadcast_ping_waits_for_the_turns_of_254_servos_and_no_longer(latency_s):
    replies = ((0.0, b"noise"), (0.7615, FEETECH.status_packet(253, 4)), (0.7635, FEETECH.status_packet(252, 0)))
    line = ScriptedPort(lambda _instruction: [(at_s + latency_s * (at_s > 0.0), data) for at_s, data in replies])
    line.latency_s = latency_s
    bus = line.open_bus()
    assert bus.broadcast_ping() == {253: 4}
    assert (bus.counters.replies, bus.counters.discarded_bytes) == (1, len(b"noise"))


def test_a_silent_line_is_asked_three_times_and_then_reported():
    line = ScriptedPort(lambda _instruction: [])
    started_s = line.clock()
    bus = line.open_bus()
    with pytest.raises(NoReply, match=r"servo 4 .* 3 instructions"):
        bus.read(4, Register.PRESENT_POSITION)
    assert (bus.counters.sent, bus.counters.timeouts, bus.counters.retries) == (ATTEMPTS, ATTEMPTS, 2)
    assert len(line.instructions) == ATTEMPTS
    assert line.clock() - started_s < ATTEMPTS * 0.01


def test_no_two_reads_in_a_row_nor_blocks_of_different_length_ask_for_the_same_number_of_bytes():
    line = ScriptedPort(honest)
    bus = line.open_bus()
    for _ in range(len(READ_LENGTHS)):
        bus.read(1, Register.PRESENT_TEMPERATURE)
    lengths = [instruction.parameters[1] for instruction in line.instructions]
    assert len(set(lengths)) == len(READ_LENGTHS)
    assert max(register.size for register in Register) < min(lengths)
    assert max(lengths) < SYNC_READ_MIN_LENGTH
    line.instructions.clear()
    for _ in range(SYNC_READ_PADDINGS):
        bus.sync_read((1,), registers.CONTROL.address, registers.CONTROL.length)
        read_telemetry(bus)
    asked = {tuple(instruction.parameters[:2]) for instruction in line.instructions}
    assert {address for address, _ in asked} == {registers.CONTROL.address, TELEMETRY.address}
    assert len({length for _, length in asked}) == len(asked)


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
            assert frame.data == bytes([expected] * TELEMETRY.length)


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


def test_endless_noise_ends_in_no_reply_and_not_in_a_hang_and_an_emergency_stop_does_not_wait_for_its_end():
    line = ScriptedPort(lambda _instruction: [(0.0005 * k, bytes(64)) for k in range(4000)])
    bus, started_s = line.open_bus(), line.clock()
    with pytest.raises(NoReply):
        bus.read(1, Register.PRESENT_VOLTAGE)
    assert line.clock() - started_s < 0.2
    read_telemetry(bus)
    started_s = line.clock()
    bus.broadcast_torque_off()
    assert line.clock() == started_s
    assert (line.instructions[-1].servo_id, line.instructions[-1].code) == (BROADCAST_ID, INST_WRITE)


def good_readings_on_a_bad_line(seed: int) -> int:
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

    line = ScriptedPort(peer_of)
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
                assert frame.data == bytes([stamp, sync_id] * 8)[: TELEMETRY.length]
                good += 1
    return good


def test_no_reading_marked_good_is_wrong_whatever_the_line_does():
    for seed in range(30):
        assert good_readings_on_a_bad_line(seed) > 25, seed


ALL_IDS = (1, 2, 3)
LENGTH = 15


def frames_of(stream):
    return parse_status_frames(stream, ALL_IDS, LENGTH)


@given(st.lists(st.binary(min_size=LENGTH, max_size=LENGTH), min_size=3, max_size=3), st.integers(0, 0xFF))
def test_replies_all_arrive_with_their_error_byte_whether_or_not_noise_precedes_them(blocks, error):
    stream = b"".join(FEETECH.status_packet(i, error, block) for i, block in zip(ALL_IDS, blocks, strict=True))
    assert frames_of(stream) == frames_of(b"\x00" + stream)
    if b"\xff" not in b"".join(blocks) and error < 0x80:
        assert frames_of(stream) == {i: StatusFrame(i, error, block) for i, block in zip(ALL_IDS, blocks, strict=True)}


def test_only_whole_replies_in_their_turn_are_believed():
    for name, (stream, believed) in STREAMS.items():
        assert list(frames_of(stream)) == believed, name
    swapped = parse_status_frames(b"".join(reply(servo) for servo in (1, 2, 4, 3)), (1, 2, 3, 4), LENGTH)
    assert list(swapped) == [1, 2], "either of the last two may have a disturbed id"


def test_a_cut_reply_whose_checksum_fits_by_chance_does_not_swallow_its_neighbour():
    # Cut by two bytes, so that the neighbour's FF FF stands for the last data byte and for a checksum that then fits.
    body = bytes([1, LENGTH + 2, 0]) + bytes(14)
    missing = next(byte for byte in range(256) if checksum(body[:-1] + bytes([byte, 0xFF])) == 0xFF)
    cut = b"\xff\xff" + body[:-1] + bytes([missing])
    assert frames_of(cut + FEETECH.status_packet(2, 0, bytes(LENGTH))) == {2: StatusFrame(2, 0, bytes(LENGTH))}
    # Cut by more, so that the neighbour's header is within its data.
    cut = b"\xff\xff" + bytes([1, LENGTH + 2, 0]) + bytes(9)
    fitting = checksum(cut[2:] + b"\xff\xff" + bytes([2, LENGTH + 2, 0, 0]))
    neighbour = FEETECH.status_packet(2, 0, bytes([0, fitting, 0xFF]) + bytes(LENGTH - 3))
    assert frames_of(cut + neighbour) == {2: StatusFrame(2, 0, neighbour[5:-1])}


def reply(servo_id, data=None):
    return FEETECH.status_packet(servo_id, 0, bytes([servo_id] * LENGTH) if data is None else data)


HOLDING = (b"\xff\xff" + bytes([2, LENGTH + 2])).ljust(LENGTH, b"\0")
HOLDING_NONE = (b"\xff\xff" + bytes([9, LENGTH + 2])).ljust(LENGTH, b"\0")
HOLDING_SHORTER = (b"\xff\xff" + bytes([2, LENGTH + 1])).ljust(LENGTH, b"\0")
LYING = bytes([1, LENGTH + 3, 0]) + bytes(LENGTH)
STREAMS = {
    **{f"only {count} bytes of a reply": (reply(1)[:count], []) for count in range(len(reply(1)))},
    "another length": (reply(1, bytes(LENGTH - 1)), []),
    "a servo that contradicts itself": (reply(1) + reply(1, bytes(LENGTH)), []),
    "a repeated reply": (reply(1) * 2, [1]),
    "servo 1 as 3, and 3 itself unheard": (reply(3, bytes([1] * LENGTH)) + reply(2), []),
    "one missing between": (reply(1) + reply(3), [1, 3]),
    "the start of another": (reply(1, HOLDING) + reply(2) + reply(3), [2, 3]),
    "two bytes as a header's": (reply(1, HOLDING_NONE) + reply(2), [1, 2]),
    "a header of a shorter reply": (reply(1, HOLDING_SHORTER) + reply(2), [1, 2]),
    "a lie about its length": (b"\xff\xff" + LYING + bytes([checksum(LYING)]), []),
    **{f"noise like {count} bytes of one": (b"\xff\xff\x01\x11\x00"[:count] + reply(2), [2]) for count in range(1, 6)},
}


@given(st.integers(0, 0xFD), st.integers(1, 0x83), st.binary(max_size=60))
def test_an_instruction_is_laid_out_as_the_servos_read_it_and_none_is_longer_than_sent(servo_id, code, parameters):
    packet = instruction_packet(servo_id, code, parameters)
    packet[:2] = [0xFF, 0xFF]
    packet[-1] = checksum(bytes(packet[2:-1]))
    (read,) = InstructionParser(FEETECH).feed(bytes(packet), 0.0)
    assert (read.servo_id, read.code, read.parameters) == (servo_id, code, parameters)
    longest = MAX_INSTRUCTION_BYTES - 6
    assert len(instruction_packet(1, 3, bytes(longest))) == MAX_INSTRUCTION_BYTES
    with pytest.raises(ValueError, match=f"at most {longest} bytes"):
        instruction_packet(1, 3, bytes(longest + 1))


def test_the_sign_stands_in_each_registers_own_bit_and_every_documented_status_bit_is_named():
    values = {"HOMING_OFFSET": -16, "PRESENT_LOAD": -44, "PRESENT_POSITION": -1, "GOAL_VELOCITY": 1000}
    data = (b"\x10\x08", b"\x2c\x04", b"\x01\x80", b"\xe8\x03")
    assert {name: Register[name].decode(each) for name, each in zip(values, data, strict=True)} == values
    assert [len(status_names(status)) for status in range(256)] == [(each & 0x3F).bit_count() for each in range(256)]


@given(st.binary(min_size=TELEMETRY.length, max_size=TELEMETRY.length))
@example(bytes([0, 0x80] * 7 + [0]))  # each sign without a magnitude
@example(bytes([0, 0x04] * 7 + [0]))
def test_telemetry_is_read_as_its_registers_are_and_of_no_other_length(block):
    parsed = parse_telemetry(block)
    values = {
        Register.PRESENT_POSITION: parsed.position_ticks,
        Register.PRESENT_VELOCITY: parsed.velocity_ticks_s,
        Register.PRESENT_LOAD: round(1000.0 * parsed.load),
        Register.PRESENT_VOLTAGE: round(10.0 * parsed.voltage_v),
        Register.STATUS: parsed.status,
        Register.PRESENT_TEMPERATURE: parsed.temperature_c,
        Register.PRESENT_CURRENT: pytest.approx(parsed.current_a / 0.0065),
    }
    for register, value in values.items():
        at = register - TELEMETRY.address
        assert register.decode(block[at : at + register.size]) == value
    with pytest.raises(ValueError, match="15 bytes, not 14"):
        parse_telemetry(block[:-1])
