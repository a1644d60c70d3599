import asyncio
import itertools
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from robot.arm import Arm
from robot.arm_group import ArmGroup, joined_health, joined_state
from robot.errors import OrderRefused
from robot.faults import Fault, FaultCode
from robot.messages import (
    ArmHealth,
    ArmState,
    BusCounters,
    CommandDone,
    Mode,
    MotionEnded,
    Order,
    Outcome,
)
from robot.stop_epochs import STOP_EPOCHS
from robot.trajectory import Trajectory
from tests.helpers.fake_arm import FakeArm

LEFT, RIGHT = ("left_a", "left_b"), ("right_a", "right_b")


class OneArm(FakeArm):
    """An arm of two joints that keeps its orders, too."""

    def __init__(self, names: tuple[str, ...]) -> None:
        super().__init__(None)
        self.names = names
        self.orders: list[Order] = []
        self.state = reading(names, 1.0)

    def put(self, **positions_rad: float) -> None:
        values = np.array([positions_rad.get(name, 0.0) for name in self.names])
        self.state = replace(self.state, goal_rad=values, position_rad=values)

    def order(self, order: Order, *_arguments: object) -> asyncio.Future[CommandDone]:
        self.orders.append(order)
        answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()
        answered.set_result(CommandDone(1, done=True, message="done"))
        return answered


def reading(names: tuple[str, ...], value: float, mode: Mode = Mode.HOLDING) -> ArmState:
    values = np.full(len(names), value)
    measured = dict.fromkeys(("position_rad", "velocity_rad_s", "load", "current_a"), values)
    torque = {"goal_rad": None if mode is Mode.RELAXED else values + 0.5, "torque_enabled": mode is not Mode.RELAXED}
    return ArmState(10.0 + value, mode, names, age_s=np.zeros(len(names)), clock_s=value, **measured, **torque)


LOST = ArmState(20.0, Mode.DISCONNECTED, LEFT, reason="no such port", clock_s=3.0)


def motion(*names: str) -> Trajectory:
    positions = np.array([[float(number) for number, _ in enumerate(names)], [1.0] * len(names)])
    still = np.zeros_like(positions)
    return Trajectory(names, np.array([0.0, 1.0]), positions, still, still)


class Pair:
    """Two arms, and both as one."""

    def __init__(self, leaders: tuple[str, ...] = ()) -> None:
        self.left, self.right = OneArm(LEFT), OneArm(RIGHT)
        arms = {"left": (cast("Arm", self.left), LEFT), "right": (cast("Arm", self.right), RIGHT)}
        self.both = ArmGroup(arms, leaders)


@pytest.fixture
async def pair() -> Pair:
    return Pair()


def test_a_state_of_all_has_the_joints_of_all_the_slowest_clock_and_the_stamp_of_the_latest_reading() -> None:
    before, after = reading(LEFT, 1.0), reading(RIGHT, 2.0)
    state = joined_state({"left": before, "right": after})
    assert state.joint_names == (*LEFT, *RIGHT)
    assert state.position_rad.tolist() == [1.0, 1.0, 2.0, 2.0]
    assert (state.clock_s, state.stamp_s) == (1.0, 12.0)
    assert state.age_s.tolist() == [1.0, 1.0, 0.0, 0.0]
    # Also if the machine's clock was set.
    lost = replace(before, mode=Mode.DISCONNECTED, stamp_s=12.0, clock_s=3.0)
    for left, jump_s in itertools.product((before, lost), (3600.0, -3600.0, 6.3e8, -6.3e8)):
        later = replace(after, stamp_s=12.0 + jump_s)
        assert joined_state({"left": left, "right": later}).stamp_s == 12.0 + jump_s


def test_the_mode_of_all_is_what_most_keeps_them_from_moving() -> None:
    # The first of each pair is the mode of both.
    for both, other in (
        (Mode.MOVING, Mode.HOLDING),
        (Mode.MOVING, Mode.RELAXED),
        (Mode.RELAXED, Mode.HOLDING),
        (Mode.FAULT, Mode.DISCONNECTED),
        (Mode.DISCONNECTED, Mode.MOVING),
    ):
        for modes in ((both, other), (other, both)):
            states = {str(number): reading(LEFT, 1.0, mode) for number, mode in enumerate(modes)}
            assert joined_state(states).mode is both, modes


def test_a_relaxed_leader_keeps_nobody_from_moving_its_goals_are_where_it_is_and_one_with_a_fault_does() -> None:
    states = {"left": reading(LEFT, 1.0, Mode.RELAXED), "right": reading(RIGHT, 2.0)}
    assert joined_state(states, leaders={"left"}).mode is Mode.HOLDING
    state = joined_state(states)
    assert state.goal_rad.tolist() == [1.0, 1.0, 2.5, 2.5]
    assert not state.torque_enabled
    states["left"] = reading(LEFT, 1.0, Mode.FAULT)
    assert joined_state(states, leaders={"left"}).mode is Mode.FAULT
    assert joined_state({"left": reading(LEFT, 1.0, Mode.RELAXED)}, leaders={"left"}).mode is Mode.RELAXED


async def test_an_arm_that_is_lost_is_left_out_of_what_is_read_and_stays_where_it_was_read_last(pair: Pair) -> None:
    state = joined_state({"left": LOST, "right": reading(RIGHT, 2.0)})
    assert (state.joint_names, state.position_rad.tolist()) == (RIGHT, [2.0, 2.0])
    assert state.reason == "left: no such port"
    assert pair.both.state.position_rad is not None
    pair.left.state = LOST
    state = pair.both.state
    assert (state.mode, state.position_rad.tolist()) == (Mode.DISCONNECTED, [1.0] * 4)
    # Joint positions are unknown until every arm was read.
    never = Pair()
    never.left.state = LOST
    assert never.both.state.position_rad is None
    # A fault says which arm has it.
    fault = Fault(FaultCode.STALLED, "joint left_a is stalled", "left_a")
    pair.left.state = replace(LOST, mode=Mode.FAULT, fault=fault)
    assert pair.both.state.fault.message == "left: joint left_a is stalled"


def test_health_of_all_is_that_of_the_worst() -> None:
    counters, thirds = BusCounters(10, 9, 1, 2, 3), (1.0, 2.0, 3.0)
    one = ArmHealth(5.0, Mode.HOLDING, "/dev/a", (), counters, thirds, (1.0, 1.0, 1.0), True)
    slow = {"lateness_s": (0.0, 5.0, 1.0), "real_time": False, "real_time_factor": 0.5, "monotonic_s": 4.0}
    both = joined_health({"a": one, "b": replace(one, port="/dev/b", **slow)})
    assert both.port == "/dev/a, /dev/b"
    assert both.bus == BusCounters(20, 18, 2, 4, 6)
    assert (both.lateness_s, both.real_time, both.real_time_factor) == ((1.0, 5.0, 3.0), False, 0.5)
    assert both.monotonic_s == 4.0


async def test_the_part_of_some_joints_is_the_arm_or_arms_that_have_them_the_same_each_time(pair: Pair) -> None:
    assert pair.both.part(("left_b",)) is pair.left
    assert pair.both.part(RIGHT) is pair.right
    assert pair.both.part((*LEFT, *RIGHT)) is pair.both
    arms = {name: OneArm((f"{name}_a",)) for name in ("x", "y", "z")}
    all_of = ArmGroup({name: (cast("Arm", arm), arm.names) for name, arm in arms.items()})
    two = all_of.part(("x_a", "z_a"))
    assert two is all_of.part(("z_a", "x_a"))
    two.stop()
    assert [bool(arms[name].stops) for name in "xyz"] == [True, False, True]


async def test_each_arm_plays_its_joints_of_a_motion_which_ends_with_the_last(pair: Pair) -> None:
    ended = pair.both.execute(motion("right_a", "left_a", "right_b"))
    assert pair.left.played[0].joint_names == ("left_a",)
    assert pair.left.played[0].positions_rad[0].tolist() == [1.0]
    assert pair.right.played[0].joint_names == ("right_a", "right_b")
    assert pair.right.played[0].positions_rad[0].tolist() == [0.0, 2.0]
    pair.left.show(0.7)
    pair.right.show(0.4)
    assert pair.both.progress(ended).fraction == pytest.approx(0.4)
    pair.left.end(Outcome.REACHED, "the arm is there")
    await asyncio.sleep(0)
    assert not ended.done()
    pair.right.end(Outcome.REACHED, "the arm is there")
    assert await ended == MotionEnded(0, Outcome.REACHED, "the arm is there")
    # A motion of one arm is played by it alone.
    pair.both.execute(motion(*LEFT))
    assert (len(pair.left.played), len(pair.right.played)) == (2, 1)


async def test_a_motion_of_both_is_stopped_in_both_also_by_what_ends_it_early_in_one(pair: Pair) -> None:
    ended = pair.both.execute(motion(*LEFT, *RIGHT))
    pair.both.stop(ended)
    assert (await ended).outcome is Outcome.STOPPED
    assert len(pair.left.stops) == len(pair.right.stops) == 1
    assert None not in (*pair.left.stops, *pair.right.stops)
    # A stop of everything reaches every arm.
    pair.both.stop()
    assert pair.left.stops[1:] == pair.right.stops[1:] == [None]
    ended = pair.both.execute(motion(*LEFT, *RIGHT), epoch=STOP_EPOCHS.present)
    pair.left.end(Outcome.FAULT, "stalled")
    answer = await ended
    assert answer.outcome is Outcome.FAULT
    assert "left: stalled" in answer.message
    assert len(pair.right.stops) == 3


async def test_an_order_to_all_reaches_every_arm_but_no_leader_is_enabled_by_it_and_a_stream_moves_one_arm() -> None:
    pair = Pair(leaders=("left",))
    assert (await pair.both.order(Order.ENABLE)).done
    assert (pair.left.orders, pair.right.orders) == ([], [Order.ENABLE])
    await pair.both.order(Order.EMERGENCY_STOP)
    assert (pair.left.orders, pair.right.orders) == ([Order.EMERGENCY_STOP], [Order.ENABLE, Order.EMERGENCY_STOP])
    assert pair.both.stream(("right_a",)).joint_names == ("right_a",)
    with pytest.raises(OrderRefused, match="not left, right"):
        pair.both.stream(("left_a", "right_a"))
