from __future__ import annotations

import numpy as np
import pytest

from robot.calibration import RAD_PER_TICK
from robot.hardware.feetech.packets import StatusFrame
from robot.hardware.feetech.registers import Register, encode
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.telemetry import (
    ASK_ALL_EVERY,
    ASK_SILENT_EVERY,
    FREE_SPEED_RAD_S,
    JUMP_RAD,
    MISSES_UNTIL_SILENT,
    ServoWatch,
)
from robot.hardware.interface import StatusFlag
from robot.limits import JointBounds
from tests.helpers.arm_rig import CALIBRATION, ROBOT

SERVOS = ServoMap(CALIBRATION, JointBounds.of(ROBOT, tuple(joint.joint for joint in CALIBRATION.joints)))


def frame(servo_id: int, ticks: int = 2048, error: int = 0) -> StatusFrame:
    data = encode(Register.PRESENT_POSITION, ticks).ljust(15, b"\0")
    return StatusFrame(servo_id, error, data)


def answered(watch: ServoWatch, *silent: int, now_s: float = 0.0) -> list[int]:
    """One cycle in which all but some servos answer; returns who was asked."""
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo) for servo in asked if servo not in silent}, now_s)
    return asked


def test_readings_are_complete_once_every_servo_has_answered() -> None:
    watch = ServoWatch(SERVOS)
    answered(watch, 3)
    assert not watch.complete
    answered(watch)
    assert watch.complete


def test_a_missed_reading_keeps_the_last_one_and_its_age() -> None:
    watch = ServoWatch(SERVOS)
    answered(watch, now_s=1.0)
    answered(watch, 3, now_s=1.01)
    ages = watch.measured(1.01, 0.0).age_s
    assert ages == pytest.approx([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])


def test_a_servo_that_stays_silent_is_asked_last_and_only_now_and_then() -> None:
    watch = ServoWatch(SERVOS)
    answered(watch)
    for _ in range(MISSES_UNTIL_SILENT):
        assert 3 in answered(watch, 3)
    rounds = [answered(watch, 3) for _ in range(10 * ASK_SILENT_EVERY)]
    with_it = [asked for asked in rounds if 3 in asked]
    assert len(with_it) == 10
    assert all(asked[-1] == 3 for asked in with_it)
    assert watch.silent_cycles[3] == MISSES_UNTIL_SILENT + len(rounds)


def test_where_none_speaks_all_are_asked_at_once_and_sequences_have_room_in_between() -> None:
    watch = ServoWatch(SERVOS)
    for _ in range(MISSES_UNTIL_SILENT):
        assert len(answered(watch, *SERVOS.ids)) == len(SERVOS.ids)
    asked = [len(answered(watch, *SERVOS.ids)) for _ in range(10 * ASK_ALL_EVERY)]
    assert sorted(asked) == [0] * 10 * (ASK_ALL_EVERY - 1) + [len(SERVOS.ids)] * 10


def test_a_servo_that_answers_again_is_asked_every_time() -> None:
    watch = ServoWatch(SERVOS)
    for _ in range(2 * ASK_SILENT_EVERY):
        answered(watch, 3)
    for _ in range(ASK_SILENT_EVERY):
        answered(watch)
    assert all(3 in answered(watch) for _ in range(ASK_SILENT_EVERY))


def test_positions_are_those_of_the_calibration() -> None:
    watch = ServoWatch(SERVOS)
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo, 1800 + servo) for servo in asked}, 0.0)
    expected = [joint.rad_from_ticks(1800 + joint.servo_id) for joint in CALIBRATION.joints]
    assert watch.measured(0.0, 0.0).position_rad == pytest.approx(expected)


def test_the_error_byte_of_the_reply_counts_as_status() -> None:
    watch = ServoWatch(SERVOS)
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo, error=int(StatusFlag.OVERLOAD)) for servo in asked}, 0.0)
    assert watch.measured(0.0, 0.0).status[0] == StatusFlag.OVERLOAD


def frames_with(servo: int, ticks: int) -> dict[int, StatusFrame]:
    """Replies of all servos, of which one stands elsewhere."""
    return {each: frame(each, ticks if each == servo else 2048) for each in SERVOS.ids}


def told(watch: ServoWatch, servo: int, ticks: int, now_s: float) -> int:
    """One cycle in which one servo tells a position; returns the one that is kept."""
    watch.take(list(SERVOS.ids), frames_with(servo, ticks), now_s)
    return kept(watch, servo, now_s)


def kept(watch: ServoWatch, servo: int, now_s: float) -> int:
    """The position of a servo that is kept [ticks]."""
    joint = SERVOS.ids.index(servo)
    return CALIBRATION.joints[joint].ticks_from_rad(float(watch.measured(now_s, 0.0).position_rad[joint]))


FAR_TICKS = round(JUMP_RAD / RAD_PER_TICK) + 200


def test_a_jump_that_no_joint_can_make_is_not_believed_once() -> None:
    watch = ServoWatch(SERVOS)
    assert told(watch, 5, 2048, 0.0) == 2048
    assert told(watch, 5, 2048 + FAR_TICKS, 0.01) == 2048
    assert watch.age_s(5, 0.01) == pytest.approx(0.01)
    assert told(watch, 5, 2050, 0.02) == 2050


def test_a_jump_that_is_told_twice_in_a_row_is_believed() -> None:
    watch = ServoWatch(SERVOS)
    told(watch, 5, 2048, 0.0)
    told(watch, 5, 2048 + FAR_TICKS, 0.01)
    assert told(watch, 5, 2048 + FAR_TICKS, 0.02) == 2048 + FAR_TICKS


def test_a_jump_that_the_same_replies_tell_again_is_believed() -> None:
    watch = ServoWatch(SERVOS)
    told(watch, 5, 2048, 0.0)
    jumped = frames_with(5, 2048 + FAR_TICKS)
    watch.take(list(SERVOS.ids), jumped, 0.01)
    assert kept(watch, 5, 0.01) == 2048
    watch.take(list(SERVOS.ids), jumped, 0.02)
    assert kept(watch, 5, 0.02) == 2048 + FAR_TICKS


def test_the_same_replies_again_are_readings_as_fresh_as_others() -> None:
    watch = ServoWatch(SERVOS)
    replies = frames_with(5, 1900)
    for now_s in (1.0, 2.0):
        watch.take(list(SERVOS.ids), replies, now_s)
    measured = watch.measured(2.01, 7.0)
    assert measured.age_s == pytest.approx(np.full(6, 0.01))
    assert measured.stamp_s == 7.0
    assert kept(watch, 5, 2.01) == 1900


def test_a_reading_that_follows_the_same_one_again_takes_its_place() -> None:
    watch = ServoWatch(SERVOS)
    replies = frames_with(5, 1900)
    for now_s in (1.0, 1.01):
        watch.take(list(SERVOS.ids), replies, now_s)
        assert kept(watch, 5, now_s) == 1900
    assert told(watch, 5, 1910, 1.02) == 1910


def test_jumps_with_a_good_reading_between_them_are_not_believed() -> None:
    watch = ServoWatch(SERVOS)
    for cycle in range(10):
        assert told(watch, 5, 2048 + FAR_TICKS * (cycle % 2), 0.01 * cycle) == 2048


def test_a_joint_that_was_not_heard_for_long_may_have_turned_far() -> None:
    watch = ServoWatch(SERVOS)
    told(watch, 5, 1000, 0.0)
    turned = round(FREE_SPEED_RAD_S * 0.5 / RAD_PER_TICK)
    assert told(watch, 5, 1000 + turned, 0.5) == 1000 + turned
