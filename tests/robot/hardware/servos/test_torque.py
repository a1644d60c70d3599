from itertools import pairwise
from typing import Any

import pytest

from robot.errors import StartupError
from robot.hardware.interface import run_to_end
from robot.hardware.servos.torque import (
    BROADCASTS,
    FIRST_TORQUE,
    LOWER_S,
    OFF_INTERVAL_S,
    OUTSIDE_LIMIT_TICKS,
    RAISE_S,
    TORQUE_ON_WITHIN_TICKS,
    ServoTorque,
    emergency_stop,
    relax,
    switch_off,
)
from tests.helpers.servo_families import IDS, Family

# By its weight and its gear's friction a joint sinks less than this (0.5 deg).
DROOP_TICKS = 6

START = {"shoulder_pan": 0.4, "shoulder_lift": -0.6, "elbow_flex": 1.1, "wrist_flex": -0.9, "wrist_roll": 0.2}
FULL = [0.8] * 5 + [0.5]


@pytest.fixture
def emulator(family: Family) -> Any:
    return family.emulator(**START)


def torque_of(family: Family, emulator: Any) -> ServoTorque:
    """The torque of servos that were surveyed."""
    torque: ServoTorque = family.in_use(emulator).hardware._torque
    return torque


@pytest.fixture
def torque(family: Family, emulator: Any) -> ServoTorque:
    return torque_of(family, emulator)


def positions(emulator: Any) -> list[float]:
    return [servo.plant.position_ticks for servo in emulator.servo_bus.servos]


def enable(torque: ServoTorque, emulator: Any) -> dict[int, int]:
    return run_to_end(torque.enable(IDS), emulator.run)


def torques(family: Family, emulator: Any) -> list[int]:
    return family.values(emulator, "TORQUE_ENABLE")


def test_torque_comes_on_low_and_slowly_without_a_jump(family: Family, emulator: Any, torque: ServoTorque) -> None:
    before, farthest = positions(emulator), 0.0
    highest_at: list[tuple[float, float]] = []
    sent = [torque._bus.counters.sent]
    for wait_s in torque.enable(IDS):
        emulator.run(wait_s + 0.002)
        sent.append(torque._bus.counters.sent)
        farthest = max(farthest, *(abs(now - was) for now, was in zip(positions(emulator), before, strict=True)))
        driven = [share for share, on in zip(family.limits(emulator), torques(family, emulator), strict=True) if on]
        if driven:
            highest_at.append((emulator.clock(), max(driven)))
        if len(driven) < len(IDS):
            first_s = emulator.clock()
            assert max(driven, default=0.0) <= FIRST_TORQUE + 0.001
    # Torque limits may be two sync writes: duties, and the gripper's current.
    assert max(after - earlier for earlier, after in pairwise(sent)) <= 2
    assert all(highest < 0.79 for at_s, highest in highest_at if at_s < first_s + 0.8 * RAISE_S)
    assert family.limits(emulator) == pytest.approx(FULL, abs=0.001)
    emulator.run(0.5)
    assert torques(family, emulator) == [1] * 6
    assert positions(emulator) == pytest.approx(before, abs=DROOP_TICKS)
    assert farthest < DROOP_TICKS


def test_servos_that_hold_keep_goals_and_others_join(family: Family, emulator: Any, torque: ServoTorque) -> None:
    goals = enable(torque, emulator)
    goal = family.value(emulator, 2, "GOAL_POSITION") + 40
    family.put(emulator, 2, "GOAL_POSITION", goal)
    family.put(emulator, 3, "TORQUE_ENABLE", 0)
    assert enable(torque_of(family, emulator), emulator)[2] == pytest.approx(goals[2] + 40, abs=1)
    assert family.value(emulator, 2, "GOAL_POSITION") == goal
    assert torques(family, emulator) == [1] * 6


def test_an_arm_sunk_in_relaxing_holds_again_where_it_is(family: Family, emulator: Any, torque: ServoTorque) -> None:
    before = enable(torque, emulator)
    steps = relax(torque._bus, IDS, torque.full_limits(), torque.full_limits())
    for _ in range(46):
        emulator.run(next(steps))
    assert max(family.limits(emulator)) < 0.1
    plant = emulator.servo_bus.servos[1].plant
    sunk = plant.position_ticks = plant.position_ticks + 200
    again, rising = torque_of(family, emulator).enable(IDS), []
    goals = run_to_end(again, lambda wait_s: (emulator.run(wait_s), rising.append(family.limits(emulator)[0])))
    assert max(after - earlier for earlier, after in pairwise(rising)) < 0.1
    assert family.limits(emulator) == pytest.approx(FULL, abs=0.001)
    emulator.run(1.0)
    assert positions(emulator)[1] == pytest.approx(sunk, abs=2 * DROOP_TICKS)
    assert goals[2] - before[2] == pytest.approx(200, abs=2 * DROOP_TICKS)


def test_an_arm_that_moves_or_is_far_outside_its_limits_is_not_switched_on(
    family: Family, emulator: Any, torque: ServoTorque
) -> None:
    plant = emulator.servo_bus.servos[2].plant
    plant.push_permille = -150.0
    with pytest.raises(StartupError, match="joint elbow_flex does not come to rest: let go of the arm"):
        enable(torque, emulator)
    plant.push_permille = 0.0
    plant.position_ticks = plant.upper_stop_ticks = plant.upper_stop_ticks + OUTSIDE_LIMIT_TICKS
    plant.block(None)
    emulator.run(0.05)
    with pytest.raises(StartupError, match=r"joint elbow_flex stands at \d+ ticks, outside .*: bring it inside"):
        enable(torque, emulator)
    assert torques(family, emulator) == [0] * 6


def test_a_servo_that_jumps_or_is_lost_in_enabling_leaves_the_arm_relaxed(
    family: Family, emulator: Any, torque: ServoTorque
) -> None:
    def knock(wait_s: float) -> None:
        emulator.run(wait_s + 0.001)
        if family.value(emulator, 4, "TORQUE_ENABLE"):
            emulator.servo_bus.servos[3].plant.position_ticks += 3 * TORQUE_ON_WITHIN_TICKS

    def lose(wait_s: float) -> None:
        emulator.run(wait_s)
        if family.value(emulator, 5, "TORQUE_ENABLE"):
            emulator.servo_bus.faults.offline = {6}

    for wait, words in (
        (knock, r"wrist_flex moved by -?\d+ ticks while torque came on; torque is off"),
        (lose, r"torque off could not be verified at gripper \(id 6\)"),
    ):
        with pytest.raises(StartupError, match=words):
            run_to_end(torque_of(family, emulator).enable(IDS), wait)
        assert torques(family, emulator) == [0] * 6


def test_relaxing_lowers_the_torque_before_it_is_off(family: Family, emulator: Any, torque: ServoTorque) -> None:
    enable(torque, emulator)
    steps = relax(torque._bus, IDS, torque.limits(dict.fromkeys(IDS, 0.4)), torque.full_limits())
    shares = []
    begun_s = emulator.clock()
    for wait_s in steps:
        emulator.run(wait_s)
        shares.append(family.limits(emulator)[0])
        if not family.value(emulator, 1, "TORQUE_ENABLE"):
            break
    assert shares[1] <= 0.4
    assert shares == sorted(shares, reverse=True)
    assert shares[-2] < 0.02
    assert emulator.clock() - begun_s == pytest.approx(LOWER_S, abs=0.2)
    assert run_to_end(steps, emulator.run) == []
    assert torques(family, emulator) == [0] * 6
    for servo, (register, value) in torque.full_limits().items():
        assert family.value(emulator, servo, register.name) == value


def test_an_emergency_stop_unheard_is_repeated_and_verified(family: Family, emulator: Any, torque: ServoTorque) -> None:
    enable(torque, emulator)
    steps = emergency_stop(torque._bus, IDS)
    emulator.servo_bus.faults.lose_instruction = 1.0
    next(steps)
    emulator.servo_bus.faults.lose_instruction = 0.0
    next(steps)
    assert torques(family, emulator) == [0] * 6
    sent = torque._bus.counters.sent
    assert run_to_end(steps) == []
    assert torque._bus.counters.sent - sent == BROADCASTS - 2 + len(IDS)


def test_servos_are_switched_off_or_named(family: Family, emulator: Any, torque: ServoTorque) -> None:
    enable(torque, emulator)
    emulator.servo_bus.faults.offline = {3, 5}
    assert run_to_end(emergency_stop(torque._bus, IDS), emulator.run) == [3, 5]
    assert run_to_end(switch_off(torque._bus, [3]), emulator.run) == [3]
    steps = switch_off(torque._bus, IDS)
    while next(steps) != OFF_INTERVAL_S:
        pass
    emulator.servo_bus.faults.offline = set()
    assert run_to_end(steps, emulator.run) == []
    assert torques(family, emulator) == [0] * 6
