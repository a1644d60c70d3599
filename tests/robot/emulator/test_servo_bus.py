import contextlib
import json
import random
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.dynamixel import CRC_ERROR, INSTRUCTION_ERROR
from robot.emulator.feetech import FEETECH as FEETECH_CODEC
from robot.emulator.feetech import FeetechServo, build_servos
from robot.emulator.servo_bus import (
    PARTIAL_PACKET_S,
    EmulatedBus,
    Faults,
    Instruction,
    InstructionParser,
    WriteLog,
)
from robot.hardware.feetech.bus import parse_status_frames
from robot.hardware.feetech.registers import Register
from tests.helpers.emulator import (
    ACTION,
    ALL,
    PING,
    READ,
    REG_WRITE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    goal_block,
    packet,
)
from tests.helpers.robots import nominal_calibration
from tests.helpers.servo_families import DYNAMIXEL, FEETECH, OF_BOTH_FAMILIES, Family

RESET = 10
IDS = (1, 2, 3)


class Wire:
    """Servos 1 to 3 of a family on a wire that takes no time."""

    def __init__(self, family: Family, **faults: float) -> None:
        self.family = family
        self.now_s = 0.0
        self.bus = EmulatedBus[Any](list(map(family.build, IDS)), family.codec, Faults(**faults), 0.0, wire_time=False)
        self.servos = self.bus.servos

    def ask(self, servo_id: int, code: int, parameters: bytes = b"") -> bytes:
        """Send an instruction; return all that comes back."""
        return self.send(self.family.build_packet(servo_id, code, parameters))

    def send(self, data: bytes, baudrate: int = 1_000_000) -> bytes:
        return b"".join(reply.data for reply in self.bus.receive(data, self.now_s, baudrate))

    def status(self, servo_id: int, data: bytes = b"", error: int = 0) -> bytes:
        return self.family.codec.status_packet(servo_id, error, data)

    def values(self, name: str) -> list[int]:
        return [servo.named(name) for servo in self.servos]


@pytest.fixture
def wire(family: Family) -> Wire:
    return Wire(family)


@OF_BOTH_FAMILIES
@given(st.integers(0, 255), st.integers(0, 255), st.binary(max_size=60), st.binary(max_size=200))
def test_any_instruction_and_any_bytes_at_all_leave_the_servos_able_to_answer(
    family: Family, servo_id: int, code: int, parameters: bytes, data: bytes
) -> None:
    wire = Wire(family)
    wire.ask(servo_id, code, parameters)
    wire.send(data)
    wire.now_s = 10.0
    servo = family.build(7)
    wire.bus.servos = wire.servos = (servo,)
    assert wire.ask(7, PING) == wire.status(7, servo.ping())


@OF_BOTH_FAMILIES
def test_an_instruction_is_answered_by_its_servo_and_a_broadcast_ping_by_all(family: Family, wire: Wire) -> None:
    replies = [wire.status(servo.servo_id, servo.ping()) for servo in wire.servos]
    assert (wire.ask(3, PING), wire.ask(9, PING), wire.ask(ALL, PING)) == (replies[2], b"", b"".join(replies))
    assert wire.ask(2, READ, family.block("ID")) == wire.status(2, b"\x02")
    assert wire.ask(ALL, READ, family.block("ID")) == b""
    assert wire.ask(2, WRITE, family.assignment("GOAL_POSITION", 2100)) == wire.status(2)
    assert wire.ask(ALL, WRITE, family.assignment("TORQUE_ENABLE", 1)) == b""
    assert (wire.values("GOAL_POSITION"), wire.values("TORQUE_ENABLE")) == ([0, 2100, 0], [1, 1, 1])
    goal = family.registers.Register.GOAL_POSITION
    data = b"".join(bytes([servo]) + goal.encode(2000 + servo) for servo in (1, 3))
    assert wire.ask(ALL, SYNC_WRITE, family.block("GOAL_POSITION") + data) == b""
    assert wire.values("GOAL_POSITION") == [2001, 2100, 2003]


@OF_BOTH_FAMILIES
@pytest.mark.parametrize(("stalls", "answering"), [(False, (3, 1)), (True, (3,))])
def test_a_sync_read_is_answered_in_its_order_and_may_end_at_a_servo_that_is_missing(
    family: Family, wire: Wire, stalls: bool, answering: tuple[int, ...]
) -> None:
    wire.bus.faults.offline, wire.bus.faults.stall_behind_missing = {2}, stalls
    replies = b"".join(wire.status(servo, bytes([servo])) for servo in answering)
    assert wire.ask(ALL, SYNC_READ, family.block("ID") + bytes([3, 2, 1])) == replies


@OF_BOTH_FAMILIES
def test_a_kept_write_waits_for_the_action_and_does_not_outlive_a_power_cut(family: Family, wire: Wire) -> None:
    for servo in IDS:
        assert wire.ask(servo, REG_WRITE, family.assignment("GOAL_POSITION", 2000 + servo)) == wire.status(servo)
    wire.servos[0].power_up()
    assert wire.values("GOAL_POSITION") == [0, 0, 0]
    for _ in range(2):
        assert wire.ask(ALL, ACTION) == b""
        assert wire.values("GOAL_POSITION") == [0, 2002, 2003]


@OF_BOTH_FAMILIES
def test_an_instruction_that_is_lost_is_not_carried_out_unlike_a_lost_reply(family: Family, wire: Wire) -> None:
    torque_on, faults = family.assignment("TORQUE_ENABLE", 1), wire.bus.faults
    faults.offline = {2}
    assert wire.ask(2, PING) == b""
    wire.ask(ALL, WRITE, torque_on)
    wire.servos[0].unplug()
    faults.offline = {3}
    wire.ask(ALL, WRITE, torque_on)
    faults.offline, faults.lose_instruction = set(), 1.0
    assert wire.ask(3, WRITE, family.assignment("TORQUE_ENABLE", 0)) == b""
    assert wire.values("TORQUE_ENABLE") == [0, 1, 1]
    faults.lose_instruction, faults.drop = 0.0, 1.0
    assert wire.ask(2, WRITE, family.assignment("GOAL_POSITION", 2500)) == b""
    for k in range(50):
        wire.bus.advance(0.02 * k)
    assert wire.servos[1].present_ticks == pytest.approx(2500, abs=1)


@OF_BOTH_FAMILIES
def test_a_reply_may_bear_a_wrong_id_and_servos_hear_whole_packets_at_their_own_baud_rate_alone(
    family: Family, wire: Wire
) -> None:
    for at in (-1, -3):
        damaged = bytearray(family.build_packet(1, WRITE, family.assignment("TORQUE_ENABLE", 1)))
        damaged[at] ^= 0xFF
        assert wire.send(bytes(damaged)) == (wire.status(1, error=CRC_ERROR) if family is DYNAMIXEL else b"")
        assert wire.values("TORQUE_ENABLE") == [0, 0, 0]
    wire.bus.faults.wrong_id = 1.0
    replies = wire.ask(2, READ, family.block("ID"))
    ((servo_id, frame),) = family.packets.parse_status_frames(replies, range(253), 1).items()
    assert (servo_id != 2, frame.data) == (True, b"\x02")
    ping = family.build_packet(3, PING, b"")
    family.write(wire.servos[2], "BAUD_RATE", 1)
    rate = wire.servos[2].baudrate
    assert rate not in (0, 1_000_000)
    assert [wire.send(ping, each) != b"" for each in (0, 1_000_000, rate)] == [False, False, True]


INSTRUCTIONS = st.builds(Instruction, st.integers(0, ALL), st.integers(1, 0x83), st.binary(max_size=60))


@OF_BOTH_FAMILIES
@given(
    st.lists(st.integers(0, 0xFE), max_size=60).map(bytes),
    st.lists(INSTRUCTIONS, max_size=4),
    st.lists(st.integers(1, 40), max_size=20),
)
def test_instructions_may_come_behind_noise_and_in_pieces_but_not_long_after_each_other(
    family: Family, noise: bytes, instructions: list[Instruction], cuts: list[int]
) -> None:
    stream = noise + b"".join(family.build_packet(each.servo_id, each.code, each.parameters) for each in instructions)
    parser, parsed = InstructionParser(family.codec), []
    for count in [*cuts, len(stream)]:
        parsed += parser.feed(stream[:count], 0.0)
        stream = stream[count:]
    assert parsed == instructions
    parser, whole = InstructionParser(family.codec), family.build_packet(2, PING, b"")
    assert parser.feed(whole[:4], 0.002) == []
    assert parser.feed(whole[4:], 0.003 + PARTIAL_PACKET_S) == []
    assert len(parser.feed(b"\xff\xff" + whole + whole, 0.004 + PARTIAL_PACKET_S)) == 2


BLOCK_READ = packet(ALL, SYNC_READ, [56, 15, *range(1, 7)])


def bus_with(faults: Faults | None = None, **settings: Any) -> EmulatedBus[FeetechServo]:
    servos = build_servos(nominal_calibration(), [0.0] * 6)
    return EmulatedBus(servos, FEETECH_CODEC, faults or Faults(), 0.0, **settings)


@pytest.fixture
def bus() -> EmulatedBus[FeetechServo]:
    return bus_with()


def said(bus, data, now_s=0.0, baudrate=1_000_000):
    return b"".join(reply.data for reply in bus.receive(data, now_s, baudrate))


def test_replies_are_due_when_their_last_byte_has_passed_the_wire_the_return_delay_and_those_before_it(bus):
    due_s = [reply.due_s - 5.0 for reply in bus.receive(BLOCK_READ, 5.0)]
    assert due_s == pytest.approx([14 * 10e-6 + (k + 1) * (21 * 10e-6 + 20e-6) for k in range(6)])
    (at_once,) = bus.receive(packet(1, PING), 6.0)
    first, second = bus.receive(packet(1, PING) + packet(2, PING), 7.0)
    assert second.due_s - first.due_s == pytest.approx(12 * 10e-6 + 20e-6)
    bus.servos[0].write(Register.RETURN_DELAY, bytes([250]))
    (delayed,) = bus.receive(packet(1, PING), 8.0)
    assert (delayed.due_s - 8.0) - (at_once.due_s - 6.0) == pytest.approx(500e-6)
    # A delayed reply has passed the wire, and holds up those behind it.
    bus.faults.delay, bus.faults.delay_s = 1.0, 0.05
    (late,) = bus.receive(packet(2, PING), 9.0)
    assert late.due_s - late.end_s == pytest.approx(0.05)
    bus.faults.delay = 0.0
    (behind,) = bus.receive(packet(3, PING), 9.01)
    assert behind.data == FEETECH_CODEC.status_packet(3, 0)
    assert behind.end_s < late.due_s <= behind.due_s


def test_who_talks_over_replies_is_not_heard_and_loses_them_but_is_heard_when_they_are_over(bus):
    bus.receive(packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    replies = bus.receive(BLOCK_READ, 1.0)
    whole = [reply.data for reply in replies]
    now_s = replies[2].start_s + 5 * 10e-6 + 1e-9
    assert said(bus, packet(ALL, WRITE, [Register.TORQUE_ENABLE, 0]), now_s) == b""
    assert {servo.value(Register.TORQUE_ENABLE) for servo in bus.servos} == {1}
    assert [reply.data for reply in replies] == [*whole[:2], whole[2][:5], b"", b"", b""]
    replies = bus.receive(BLOCK_READ, 2.0)
    assert said(bus, packet(1, PING), replies[-1].end_s) == FEETECH_CODEC.status_packet(1, 0)
    assert all(len(reply.data) == 21 for reply in replies)


@pytest.fixture
def feetechs() -> Wire:
    return Wire(FEETECH)


@pytest.fixture
def dynamixels() -> Wire:
    return Wire(DYNAMIXEL)


def test_a_servo_answers_no_more_than_its_response_level_allows_and_to_nonsense_with_an_error_at_most(
    feetechs, dynamixels
):
    assert feetechs.ask(2, 0x55) == feetechs.ask(2, READ, b"\x05") == feetechs.ask(ALL, SYNC_READ, b"\x05\x01") == b""
    assert dynamixels.ask(2, 0x92, b"\x01") == dynamixels.status(2, error=INSTRUCTION_ERROR)
    feetechs.servos[1].write(Register.RESPONSE_LEVEL, bytes([0]))
    assert feetechs.ask(2, PING) == feetechs.status(2)
    assert feetechs.ask(2, READ, FEETECH.block("ID")) == feetechs.status(2, b"\x02")
    assert feetechs.ask(2, WRITE, FEETECH.assignment("TORQUE_LIMIT", 100)) == b""
    assert feetechs.ask(ALL, SYNC_READ, FEETECH.block("ID") + b"\x02") == feetechs.status(2, b"\x02")


def test_a_reset_is_acknowledged_and_changes_nothing(feetechs):
    feetechs.servos[0].write(Register.GOAL_POSITION, Register.GOAL_POSITION.encode(1234))
    assert feetechs.ask(1, RESET) == feetechs.status(1)
    assert feetechs.values("GOAL_POSITION")[0] == 1234


def test_the_present_position_is_made_the_middle_for_good_or_as_near_as_the_offset_goes(feetechs):
    for servo, at, shown in ((2, 1000.0, 2048), (0, 0.0, 2047)):
        made = feetechs.servos[servo]
        made.plant.position_ticks = at
        made.write(Register.TORQUE_ENABLE, bytes([1]))
        feetechs.ask(servo + 1, WRITE, bytes([Register.TORQUE_ENABLE, 128]))
        assert (made.present_ticks, made.value(Register.TORQUE_ENABLE)) == (shown, 1)
        made.power_up()
        assert made.present_ticks == shown
    assert feetechs.values("HOMING_OFFSET")[0] == -2047


def test_writes_and_commands_are_recorded_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "writes.jsonl"
    with contextlib.closing(WriteLog(path)) as log:
        bus = bus_with(Faults(offline={6}), log=log)
        bus.receive(packet(1, PING) + packet(1, READ, [56, 2]) + packet(9, WRITE, [40, 0]), 1.0)
        bus.receive(packet(2, WRITE, [48, 1, 2]), 2.0)
        bus.receive(packet(ALL, WRITE, [40, 0]), 3.0)
        bus.receive(packet(ALL, SYNC_WRITE, [41, 1, 1, 254, 3, 100]), 4.0)
        bus.receive(packet(2, REG_WRITE, [48, 3, 2]), 5.0)
        bus.receive(packet(ALL, ACTION), 6.0)
        bus.record_command({"push": {"3": 1}})
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(line["t"], line["instruction"], line["address"], line["data"]) for line in lines] == [
        (2.0, "write", 48, {"2": [1, 2]}),
        (3.0, "write", 40, {str(i): [0] for i in range(1, 6)}),
        (4.0, "sync_write", 41, {"1": [254], "3": [100]}),
        (6.0, "action", 48, {"2": [3, 2]}),
        (6.0, "command", None, {}),
    ]


def test_every_instruction_on_the_bus_feeds_every_watchdog(dynamixels):
    for servo in dynamixels.servos:
        servo.hold()
    dynamixels.ask(ALL, WRITE, DYNAMIXEL.assignment("BUS_WATCHDOG", 5))
    for tick in range(1, 50):
        dynamixels.now_s = 0.01 * tick
        dynamixels.ask(1, READ, DYNAMIXEL.block("LED"))
    assert dynamixels.values("BUS_WATCHDOG") == [5, 5, 5]
    dynamixels.bus.advance(1.0)
    assert dynamixels.values("BUS_WATCHDOG") == [-1, -1, -1]


ID = 1
SENT = FEETECH_CODEC.status_packet(ID, 0, bytes(15))


def faults(seed=5, **probabilities):
    return Faults(**probabilities, random=random.Random(seed))


def arrived(chance):
    return chance.apply(FEETECH_CODEC.status_packet(chance.id_of_reply(ID), 0, bytes(15)))


@pytest.mark.parametrize("name", ["drop", "corrupt", "wrong_id", "truncate", "duplicate", "noise"])
def test_a_reply_is_struck_as_often_as_asked_and_alike_for_a_seed(name):
    def arrivals():
        chance = faults(**{name: 0.3})
        return [arrived(chance) for _ in range(1000)]

    assert sum(each == SENT for each in arrivals()) == pytest.approx(700, abs=60)
    assert arrivals() == arrivals()


@given(st.integers(0, 2**32), st.sampled_from(["drop", "corrupt", "wrong_id", "truncate"]))
def test_a_reply_that_is_struck_is_never_taken_for_a_good_one_but_a_doubled_and_a_noisy_one_are(seed, name):
    assert parse_status_frames(arrived(faults(seed, **{name: 1.0})), [ID], 15) == {}
    assert arrived(faults(duplicate=1.0)) == SENT * 2
    noisy = arrived(faults(noise=1.0))
    assert noisy.endswith(SENT)
    assert len(noisy) > len(SENT)


def test_a_line_has_the_write_by_its_whole_registers_and_the_state_of_every_servo(tmp_path):
    block, servos, log = goal_block(-5, 700), build_servos(nominal_calibration(), [0.0] * 6), WriteLog(tmp_path / "log")
    servos[1].write(40, b"\x01")
    before_s = time.monotonic()
    log.record_write(12.5, 0x83, 41, {3: block, 4: block[:2]}, servos)
    # Not closed: a killed process leaves all.
    (line,) = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    log.close()
    assert before_s <= line.pop("machine_t") <= time.monotonic()
    whole = {"ACCELERATION": 254, "GOAL_POSITION": -5, "GOAL_TIME": 0, "GOAL_VELOCITY": 700}
    assert line == {
        "t": 12.5,
        "instruction": "sync_write",
        "address": 41,
        "data": {"3": list(block), "4": list(block[:2])},
        "registers": {"3": whole, "4": {"ACCELERATION": 254}},
        "present": {str(servo.servo_id): servo.present_ticks for servo in servos},
        "torque": {"1": 0, "2": 1, "3": 0, "4": 0, "5": 0, "6": 0},
        "goal": {str(i): 0 for i in range(1, 7)},
        "limit": {str(i): 1000 for i in range(1, 7)},
        "status": {str(i): 0 for i in range(1, 7)},
    }
