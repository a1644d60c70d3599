from __future__ import annotations

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator import servo_bus
from robot.emulator.arm import build_servos
from robot.emulator.control import Emulation, answer
from robot.emulator.faults import Faults
from robot.emulator.servo_bus import BAUDRATES, ServoBus, status_packet
from robot.emulator.write_log import WriteLog
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, decode, goal_block
from robot.hardware.interface import StatusFlag
from tests.helpers.emulator import (
    ALL,
    COMMANDS,
    IDS,
    PING,
    QUESTIONS,
    READ,
    REQUESTS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    packet,
)
from tests.helpers.resources import examples
from tests.helpers.robots import nominal_calibration

BLOCK_READ = packet(ALL, SYNC_READ, [56, 15, *IDS])


def bus_with(faults=None, log=None):
    return ServoBus(build_servos(nominal_calibration(), [0.0] * 6), faults or Faults(), 0.0, log)


def bus_without_wire_time(faults=None):
    return ServoBus(build_servos(nominal_calibration(), [0.0] * 6), faults or Faults(), 0.0, wire_time=False)


@pytest.fixture
def bus():
    return bus_with()


def said(bus, data, now_s=0.0, baudrate=1_000_000):
    return b"".join(reply.data for reply in bus.receive(data, now_s, baudrate))


@given(st.binary(max_size=200))
def test_any_bytes_at_all_leave_the_servos_able_to_answer(data):
    bus = bus_with()
    bus.receive(data, 0.0)
    servo = bus.servos[0]
    servo.write(Register.RETURN_DELAY, bytes([0]))
    servo.write(Register.BAUD_RATE, bytes([0]))
    assert status_packet(servo.servo_id, servo.error) in said(bus, packet(servo.servo_id, PING), 10.0)


def test_an_instruction_with_a_wrong_checksum_is_not_carried_out(bus):
    good = packet(1, PING)
    assert said(bus, good[:-1] + bytes([good[-1] ^ 1])) == b""
    assert said(bus, good) == status_packet(1, 0)


def test_replies_are_due_when_their_last_byte_has_passed_the_wire(bus):
    replies = bus.receive(BLOCK_READ, 5.0)
    assert [reply.due_s - 5.0 for reply in replies] == pytest.approx(
        [14 * 10e-6 + (k + 1) * (21 * 10e-6 + 20e-6) for k in range(6)]
    )


def test_the_return_delay_holds_up_each_reply(bus):
    (at_once,) = bus.receive(packet(1, PING), 1.0)
    bus.servos[0].write(Register.RETURN_DELAY, bytes([250]))
    (delayed,) = bus.receive(packet(1, PING), 2.0)
    assert (delayed.due_s - 2.0) - (at_once.due_s - 1.0) == pytest.approx(500e-6)


def test_instructions_that_come_together_are_answered_one_after_the_other(bus):
    first, second = bus.receive(packet(1, PING) + packet(2, PING), 0.0)
    assert second.due_s - first.due_s == pytest.approx(12 * 10e-6 + 20e-6)


def test_who_talks_over_replies_is_not_heard_and_loses_them(bus):
    bus.receive(packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    replies = bus.receive(BLOCK_READ, 1.0)
    whole = [reply.data for reply in replies]
    now_s = replies[2].start_s + 5 * 10e-6 + 1e-9
    assert said(bus, packet(ALL, WRITE, [Register.TORQUE_ENABLE, 0]), now_s) == b""
    assert {servo.value(Register.TORQUE_ENABLE) for servo in bus.servos} == {1}
    assert [reply.data for reply in replies] == [*whole[:2], whole[2][:5], b"", b"", b""]


def test_who_talks_when_the_replies_are_over_is_heard(bus):
    replies = bus.receive(BLOCK_READ, 1.0)
    assert said(bus, packet(1, PING), replies[-1].end_s) == status_packet(1, 0)
    assert all(len(reply.data) == 21 for reply in replies)


def test_a_servo_offline_neither_hears_nor_speaks(bus):
    bus.faults.offline.add(2)
    assert said(bus, packet(2, PING)) == b""
    bus.receive(packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    assert [servo.value(Register.TORQUE_ENABLE) for servo in bus.servos] == [1, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("code", sorted(BAUDRATES))
def test_a_servo_hears_only_at_its_own_baud_rate(bus, code):
    bus.servos[2].write(Register.BAUD_RATE, bytes([code]))
    heard_at = [rate for rate in BAUDRATES.values() if said(bus, packet(3, PING), float(rate), rate)]
    assert heard_at == [BAUDRATES[code]]


def test_a_lost_instruction_is_neither_carried_out_nor_answered():
    bus = bus_with(Faults(lose_instruction=1.0))
    assert said(bus, packet(1, WRITE, [Register.TORQUE_ENABLE, 1])) == b""
    assert bus.servos[0].value(Register.TORQUE_ENABLE) == 0


def test_a_delayed_reply_has_passed_the_wire_and_holds_up_those_behind_it():
    bus = bus_with(Faults(delay=1.0, delay_s=0.05))
    (late,) = bus.receive(packet(1, PING), 0.0)
    assert late.due_s - late.end_s == pytest.approx(0.05)
    bus.faults.delay = 0.0
    (behind,) = bus.receive(packet(2, PING), 0.01)
    assert behind.data == status_packet(2, 0)
    assert behind.end_s < late.due_s <= behind.due_s


def test_servos_move_while_the_bus_is_silent(bus):
    bus.receive(packet(1, WRITE, [GOAL_ADDRESS, *goal_block(2500, 1000)]), 0.0)
    bus.receive(packet(1, WRITE, [Register.TORQUE_ENABLE, 1]), 0.01)
    for k in range(50):
        bus.advance(0.02 * k)
    assert bus.servos[0].present_ticks == 2500


@pytest.mark.parametrize(("hand_ticks", "least", "most"), [(1000, 8, 11), (None, 0, 0)], ids=["moving", "at rest"])
def test_the_weight_is_put_on_at_once_and_again_as_the_arm_moves(hand_ticks, least, most):
    times = []
    bus = ServoBus(build_servos(nominal_calibration(), [0.0] * 6), Faults(), 0.0, weigh=lambda: times.append(1))
    assert len(times) == 1
    bus.servos[0].plant.hand_ticks = hand_ticks
    for k in range(1, 101):
        bus.advance(0.001 * k)
    assert least <= len(times) - 1 <= most


EVENTS = st.one_of(
    REQUESTS,
    st.sampled_from([0.001, 0.01, 0.03, 0.1, 2.5]),
    st.sampled_from([1_000_000, 500_000]),
    st.sampled_from(COMMANDS),
)
# Few different ones, so that they come again.
HISTORIES = st.lists(EVENTS, min_size=1, max_size=5).flatmap(lambda few: st.lists(st.sampled_from(few), max_size=20))


class NoAdapter:
    port = ""
    frozen = False
    frame_s = 0.0

    def plug_in(self, *, renamed: bool = False) -> None: ...

    def unplug(self) -> None: ...


class FreshAndCached:
    """The same servos twice, of which one may answer out of its cache.

    Between two events both are asked all that they can tell, often enough for most answers to be cached.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self.baudrate = 1_000_000
        self.cached, self.fresh = bus_without_wire_time(), bus_without_wire_time()

    def happen(self, event: bytes | float | int | dict[str, object]) -> None:
        """Let a request, some time, a change of the host's baud rate, or a live command happen to both."""
        match event:
            case bytes():
                self.ask(event)
            case float():
                self.now_s += event
            case int():
                self.baudrate = event
            case _:
                line = json.dumps(event).encode()
                assert len({answer(line, Emulation(bus, NoAdapter())) for bus in (self.cached, self.fresh)}) == 1

    def ask(self, request: bytes) -> None:
        """Compare what both say."""
        self.fresh._answered.clear()
        wanted = self.fresh.receive(request, self.now_s, self.baudrate)
        got = self.cached.receive(request, self.now_s, self.baudrate)
        assert b"".join(reply.data for reply in got) == b"".join(reply.data for reply in wanted)
        assert [reply.due_s for reply in got[-1:]] == [reply.due_s for reply in wanted[-1:]]


@examples(200)
@given(HISTORIES)
def test_no_answer_out_of_the_cache_differs_from_a_fresh_one(events):
    both = FreshAndCached()
    for event in events:
        both.happen(event)
        for question in QUESTIONS:
            both.ask(question)


def test_cached_replies_follow_registers_that_change_by_themselves():
    """A joint that is stalled cuts its torque in the end."""
    both, statuses = FreshAndCached(), set()
    blocked = {"obstacle": {"3": 2100}}
    for event in (
        blocked,
        packet(3, WRITE, [Register.TORQUE_ENABLE, 1]),
        packet(3, WRITE, [GOAL_ADDRESS, *goal_block(2500, 0)]),
    ):
        both.happen(event)
    for _ in range(400):
        both.happen(0.01)
        both.ask(QUESTIONS[0])
        servo = both.cached.servos[2]
        load = decode(Register.PRESENT_LOAD, servo.read(Register.PRESENT_LOAD, 2))
        assert load == round(servo.plant.duty_permille)
        statuses.add(servo.error)
    assert statuses == {0, StatusFlag.OVERLOAD}


def test_the_beginning_of_an_instruction_spoils_what_follows_it_whatever_the_cache_holds():
    both, torn = FreshAndCached(), packet(3, PING) + packet(1, PING)[:-3]
    for _ in range(3):
        both.happen(torn)
        for _ in range(2):
            both.happen(QUESTIONS[0])
        both.happen(1.0)
        both.happen(QUESTIONS[0])


def test_the_cached_replies_of_an_arm_at_rest_follow_its_temperature():
    both, temperatures = FreshAndCached(), set()
    both.happen({"temperature": {"3": 60}, "heat_rate": 60})
    for _ in range(600):
        both.happen(0.01)
        both.ask(QUESTIONS[1])
        servo = both.cached.servos[2]
        (shown,) = servo.read(Register.PRESENT_TEMPERATURE, 1)
        assert shown == round(servo.motor.temperature_c)
        temperatures.add(shown)
    assert len(temperatures) > 5


def test_an_arm_at_rest_answers_what_it_was_asked_before_without_looking_again(monkeypatch):
    bus, executed = bus_without_wire_time(), []
    monkeypatch.setattr(servo_bus, "execute", lambda instruction, *_, **__: executed.append(instruction) or [])
    for k in range(1, 10):
        bus.receive(BLOCK_READ, 0.01 * k)
    assert len(executed) == 1


def test_without_wire_time_every_reply_is_there_at_once_whatever_the_return_delay():
    bus = bus_without_wire_time()
    bus.servos[0].write(Register.RETURN_DELAY, bytes([250]))
    assert [reply.due_s for reply in bus.receive(BLOCK_READ, 5.0)] == [5.0] * 6
    assert said(bus, packet(1, PING), 5.0) == status_packet(1, 0)


def test_without_wire_time_a_delayed_reply_holds_up_those_behind_it():
    bus = bus_without_wire_time(Faults(delay=1.0, delay_s=0.05))
    (late,) = bus.receive(packet(1, PING), 0.0)
    bus.faults.delay = 0.0
    (behind,) = bus.receive(packet(2, PING), 0.01)
    assert behind.due_s == late.due_s == pytest.approx(0.05)
    (behind_again,) = bus.receive(packet(2, PING), 0.02)
    assert behind_again.due_s == late.due_s


def test_writes_and_commands_are_recorded_and_nothing_else(tmp_path):
    path = tmp_path / "writes.jsonl"
    with contextlib.closing(WriteLog(path)) as log:
        bus = bus_with(Faults(offline={6}), log)
        bus.receive(packet(1, PING) + packet(1, READ, [56, 2]) + packet(9, WRITE, [40, 0]), 1.0)
        bus.receive(packet(2, WRITE, [48, 1, 2]), 2.0)
        bus.receive(packet(ALL, WRITE, [40, 0]), 3.0)
        bus.receive(packet(ALL, SYNC_WRITE, [41, 1, 1, 254, 3, 100]), 4.0)
        bus.record_command({"push": {"3": 1}})
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(line["t"], line["instruction"], line["address"], line["data"]) for line in lines] == [
        (2.0, "write", 48, {"2": [1, 2]}),
        (3.0, "write", 40, {str(i): [0] for i in IDS[:5]}),
        (4.0, "sync_write", 41, {"1": [254], "3": [100]}),
        (4.0, "command", None, {}),
    ]
