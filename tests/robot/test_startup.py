from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robot import model
from robot.bus import Bus
from robot.calibration import Calibration
from robot.driver import JointBounds
from robot.errors import StartupError
from robot.registers import GOAL_ADDRESS, Register, goal_block
from robot.startup import FIRST_TORQUE, FULL_TORQUE, GRIPPER_TORQUE, TORQUE_ON_WITHIN_TICKS, TakenOver, take_over
from tests.helpers.server import read_write_log
from tests.robot.conftest import RunningEmulator

CALIBRATION = Calibration.nominal()
IDS = [joint.servo_id for joint in CALIBRATION.joints]
BOUNDS = JointBounds.of(model.builtin(), tuple(joint.joint for joint in CALIBRATION.joints))
LIMITS = {
    joint.servo_id: (joint.ticks_from_rad(low), joint.ticks_from_rad(high))
    for joint, low, high in zip(CALIBRATION.joints, BOUNDS.lower_rad, BOUNDS.upper_rad, strict=True)
}
CAPS = dict.fromkeys(IDS, 1800)

Start = Callable[..., RunningEmulator]


@contextlib.contextmanager
def bus_of(emulator: RunningEmulator) -> Iterator[Bus]:
    bus = Bus.open(emulator.port)
    try:
        yield bus
    finally:
        bus.close()


def start(bus: Bus, limits: dict[int, tuple[int, int]] = LIMITS) -> TakenOver:
    return take_over(bus, CALIBRATION, limits, CAPS, lambda _seconds: None)


def test_a_relaxed_arm_is_held_where_it_is(start_emulator: Start) -> None:
    with bus_of(start_emulator("--start", "0.5,-0.5,0.5,0.2,0.1,0.3")) as bus:
        taken = start(bus)
        assert not taken.adopted
        for servo in IDS:
            assert bus.read(servo, Register.TORQUE_ENABLE) == 1
            assert bus.read(servo, Register.GOAL_POSITION) == taken.goal_ticks[servo]
            assert abs(bus.read(servo, Register.PRESENT_POSITION) - taken.goal_ticks[servo]) < TORQUE_ON_WITHIN_TICKS


def test_torque_comes_on_at_the_goal_and_capped(start_emulator: Start, tmp_path: Path) -> None:
    log = tmp_path / "writes.jsonl"
    with bus_of(start_emulator("--write-log", str(log), "--start", "0.5,-0.5,0.5,0.2,0.1,0.3")) as bus:
        start(bus)
    goals: dict[str, int] = {}
    limits: dict[str, int] = {}
    switched_on = set()
    for entry in read_write_log(log):
        for servo, data in entry["data"].items():
            if entry["address"] == GOAL_ADDRESS:
                goals[servo] = data[1] | data[2] << 8
            elif entry["address"] == Register.TORQUE_LIMIT:
                limits[servo] = data[0] | data[1] << 8
            elif entry["address"] == Register.TORQUE_ENABLE and data == [1]:
                switched_on.add(servo)
                assert abs(goals[servo] - entry["present"][servo]) <= TORQUE_ON_WITHIN_TICKS
                assert limits[servo] == FIRST_TORQUE
    assert switched_on == {str(servo) for servo in IDS}


def test_torque_is_raised_to_its_full_value_and_less_for_the_gripper(start_emulator: Start) -> None:
    with bus_of(start_emulator()) as bus:
        start(bus)
        limits = [bus.read(servo, Register.TORQUE_LIMIT) for servo in IDS]
    assert limits == [FULL_TORQUE] * 5 + [GRIPPER_TORQUE]


def test_an_arm_that_holds_is_adopted_and_not_one_register_is_written(start_emulator: Start, tmp_path: Path) -> None:
    log = tmp_path / "writes.jsonl"
    with bus_of(start_emulator("--write-log", str(log))) as bus:
        first = start(bus)
        bus.ping(1)  # the emulator has then logged all that came before
        written = len(read_write_log(log))
        second = start(bus)
        assert second.adopted
        assert second.goal_ticks == first.goal_ticks
        bus.ping(1)
        assert len(read_write_log(log)) == written


def test_a_half_switched_arm_is_completed(start_emulator: Start) -> None:
    with bus_of(start_emulator()) as bus:
        start(bus)
        bus.write(3, Register.TORQUE_ENABLE, 0)
        assert not start(bus).adopted
        assert bus.read(3, Register.TORQUE_ENABLE) == 1


def test_a_goal_far_from_the_arm_is_not_adopted(start_emulator: Start) -> None:
    with bus_of(start_emulator()) as bus:
        start(bus)
        present = bus.read(1, Register.PRESENT_POSITION)
        # At the slowest speed the servo stays far behind this goal for long.
        bus.sync_write(GOAL_ADDRESS, {1: goal_block(present + 800, 1, 254)})
        taken = start(bus)
        assert abs(taken.goal_ticks[1] - present) < 60


@pytest.mark.parametrize(
    ("offline", "words"),
    [([3], "no answer from elbow_flex (id 3)"), (IDS, "no servo answers: is the arm powered")],
)
def test_missing_servos_are_named_with_the_likely_cause(start_emulator: Start, offline: list[int], words: str) -> None:
    emulator = start_emulator()
    emulator.command(offline=offline)
    with bus_of(emulator) as bus, pytest.raises(StartupError) as refused:
        start(bus)
    assert words in str(refused.value)


def test_an_arm_outside_its_limits_is_not_switched_on(start_emulator: Start) -> None:
    with bus_of(start_emulator("--start", "1.5,0,0,0,0,0")) as bus:
        with pytest.raises(StartupError, match="shoulder_pan stands at"):
            start(bus, {**LIMITS, 1: (1500, 2500)})
        assert [bus.read(servo, Register.TORQUE_ENABLE) for servo in IDS] == [0] * 6


def test_a_servo_in_another_operating_mode_is_refused(start_emulator: Start) -> None:
    with bus_of(start_emulator()) as bus:
        bus.write(2, Register.LOCK, 0)
        bus.write(2, Register.OPERATING_MODE, 1)
        with pytest.raises(StartupError, match=r"servo 2 \(shoulder_lift\) is in operating mode 1"):
            start(bus)


def test_lost_replies_do_not_hinder_the_start(start_emulator: Start) -> None:
    with bus_of(start_emulator("--drop", "0.02", "--corrupt", "0.02", "--seed", "3")) as bus:
        start(bus)
        assert bus.counters.timeouts > 0
