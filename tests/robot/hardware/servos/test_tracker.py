from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest

from robot.calibration import RAD_PER_TICK
from robot.hardware.dynamixel.packets import ALERT
from robot.hardware.dynamixel.registers import MOTION
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.bus import StatusFrame
from robot.hardware.servos.family import ServoFamily
from robot.hardware.servos.tracker import (
    ASK_ALL_EVERY,
    ASK_SILENT_EVERY,
    EMPTY_READS_PER_SERVO,
    MISSES_UNTIL_LAST,
    MISSES_UNTIL_SILENT,
    ServoTracker,
)
from tests.helpers.servo_families import DYNAMIXEL, IDS, Family


@pytest.fixture
def tracker(family: Family) -> ServoTracker:
    return ServoTracker(family.driver, family.servo_map)


def answered(family: Family, tracker: ServoTracker, *silent: int, now_s: float = 0.0) -> list[int]:
    """One cycle in which all but some servos answer; returns who was asked."""
    asked: list[int] = tracker.ids_to_ask()
    tracker.take(asked, {servo: family.frame(servo, 2048) for servo in asked if servo not in silent}, now_s)
    return asked


def test_readings_are_complete_once_every_servo_has_answered(family: Family, tracker: ServoTracker) -> None:
    assert tracker.age_s(3, 1.0) == math.inf
    answered(family, tracker, 3)
    assert not tracker.complete
    answered(family, tracker)
    assert tracker.complete


def test_a_servo_that_stays_silent_is_asked_last_and_only_now_and_then(family: Family, tracker: ServoTracker) -> None:
    answered(family, tracker)
    for _ in range(MISSES_UNTIL_SILENT):
        assert 3 in answered(family, tracker, 3)
    rounds = [answered(family, tracker, 3) for _ in range(10 * ASK_SILENT_EVERY)]
    with_it = [asked for asked in rounds if 3 in asked]
    assert len(with_it) == 10
    assert all(asked[-1] == 3 for asked in with_it)
    assert tracker.silent_cycles[3] == MISSES_UNTIL_SILENT + len(rounds)


def test_where_none_speaks_all_are_asked_at_once_and_sequences_have_room_in_between(
    family: Family, tracker: ServoTracker
) -> None:
    for _ in range(EMPTY_READS_PER_SERVO * len(IDS)):
        assert len(answered(family, tracker, *IDS)) == len(IDS)
    every = ASK_ALL_EVERY
    asked = [len(answered(family, tracker, *IDS)) for _ in range(10 * every)]
    assert sorted(asked) == [0] * 10 * (every - 1) + [len(IDS)] * 10


FAR_TICKS = round(ServoFamily.jump_rad / RAD_PER_TICK) + 200


def replies(family: Family, ticks: int) -> dict[int, Any]:
    """Replies of all servos, of which the fifth stands somewhere else."""
    return {servo: family.frame(servo, ticks if servo == 5 else 2048) for servo in IDS}


def kept(family: Family, tracker: ServoTracker, told: dict[int, Any], now_s: float) -> int:
    """One cycle with some replies; returns the position of the fifth servo that is kept [ticks]."""
    tracker.take(list(IDS), told, now_s)
    return family.calibration.joints[4].ticks_from_rad(float(tracker.measured(now_s, 0.0).position_rad[4]))


def test_a_jump_that_no_joint_can_make_is_not_believed_once(family: Family, tracker: ServoTracker) -> None:
    assert kept(family, tracker, replies(family, 2048), 0.0) == 2048
    for cycle in range(1, 10):
        at_s, ticks = 0.01 * cycle, 2048 + FAR_TICKS * (cycle % 2)
        assert kept(family, tracker, replies(family, ticks), at_s) == 2048
        assert tracker.age_s(5, at_s) == pytest.approx(0.01 * (cycle % 2))


@pytest.mark.parametrize("repeated", [False, True], ids=["equal replies", "the same replies"])
def test_a_jump_in_two_readings_in_a_row_is_believed(family: Family, tracker: ServoTracker, repeated: bool) -> None:
    kept(family, tracker, replies(family, 2048), 0.0)
    jumped = replies(family, 2048 + FAR_TICKS)
    assert kept(family, tracker, jumped, 0.01) == 2048
    again = jumped if repeated else replies(family, 2048 + FAR_TICKS)
    assert kept(family, tracker, again, 0.02) == 2048 + FAR_TICKS


def test_the_same_replies_again_are_readings_as_fresh_as_others(family: Family, tracker: ServoTracker) -> None:
    told = replies(family, 1900)
    for now_s in (1.0, 2.0):
        assert kept(family, tracker, told, now_s) == 1900
    measured = tracker.measured(2.01, 7.0)
    assert measured.age_s == pytest.approx(np.full(6, 0.01))
    assert measured.stamp_s == 7.0
    assert kept(family, tracker, replies(family, 1910), 2.02) == 1910


def test_a_joint_that_was_not_heard_for_long_may_have_turned_far(family: Family, tracker: ServoTracker) -> None:
    kept(family, tracker, replies(family, 1000), 0.0)
    turned = 1000 + round(5.5 * 0.5 / RAD_PER_TICK)
    assert kept(family, tracker, replies(family, turned), 0.5) == turned


@pytest.mark.parametrize("blinded", [False, True], ids=["alone", "with those behind it"])
def test_a_silent_servo_silences_the_others_for_a_few_cycles_at_most(
    family: Family, tracker: ServoTracker, blinded: bool
) -> None:
    answered(family, tracker)
    for cycle in range(1, 4 * ASK_SILENT_EVERY):
        asked = tracker.ids_to_ask()
        behind = asked[asked.index(2) :] if blinded and 2 in asked else [2]
        told = {servo: family.frame(servo, 2048) for servo in asked if servo not in behind}
        tracker.take(asked, told, 0.01 * cycle)
        others = np.delete(tracker.measured(0.01 * cycle, 0.0).age_s, 1)
        assert others.max() <= 0.01 * MISSES_UNTIL_LAST + 1e-9
    assert tracker.is_silent(2)
    assert not any(tracker.is_silent(servo) for servo in IDS if servo != 2)


def test_a_servo_that_misses_its_turn_is_asked_behind_the_others(family: Family, tracker: ServoTracker) -> None:
    answered(family, tracker)
    for _ in range(MISSES_UNTIL_LAST):
        answered(family, tracker, 2)
    assert answered(family, tracker, 2) == [1, 3, 4, 5, 6, 2]
    answered(family, tracker)
    assert answered(family, tracker) == [1, 2, 3, 4, 5, 6]


def test_a_silent_servo_that_must_be_seen_is_asked_at_once(family: Family, tracker: ServoTracker) -> None:
    for _ in range(MISSES_UNTIL_SILENT):
        answered(family, tracker, 3)
    assert tracker.is_silent(3)
    tracker.ask_again(3)
    assert 3 in tracker.ids_to_ask()


# Dynamixel alone: supply and temperature now and then, turns, and an error register.


def dynamixel_replies(ticks: int = 2048, *, alerting: int = 0, whole: bool = True) -> dict[int, StatusFrame]:
    """Replies of all servos, of which one may report an error."""
    data = struct.pack("<hhiiiiHB", -443, 350, 10, ticks, 0, 0, 118, 41)
    return {
        servo: StatusFrame(servo, ALERT if servo == alerting else 0, data if whole else data[: MOTION.length])
        for servo in IDS
    }


@pytest.fixture
def dynamixels() -> ServoTracker:
    return ServoTracker(DYNAMIXEL.driver, DYNAMIXEL.servo_map)


def test_readings_are_incomplete_without_supply_and_temperature(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(whole=False), 0.0)
    assert not dynamixels.complete


def test_readings_are_in_the_units_of_the_controller(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(), 0.0)
    measured = dynamixels.measured(0.25, 7.0)
    assert measured.position_rad == pytest.approx(
        [joint.rad_from_ticks(2048) for joint in DYNAMIXEL.calibration.joints]
    )
    assert measured.velocity_rad_s[:5] == pytest.approx([2.29 * 2 * np.pi / 60] * 5)
    assert measured.load == pytest.approx([-443 / 885] * 6)
    assert np.isnan(measured.current_a[:2]).all()
    assert measured.current_a[2:] == pytest.approx([0.35] * 4)
    assert measured.voltage_v == pytest.approx([11.8] * 6)
    assert measured.temperature_c == pytest.approx([41.0] * 6)
    assert measured.age_s == pytest.approx([0.25] * 6)
    assert measured.stamp_s == 7.0


def test_supply_and_temperature_are_kept_between_their_readings(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(), 0.0)
    dynamixels.take(IDS, dynamixel_replies(2050, whole=False), 0.01)
    measured = dynamixels.measured(0.01, 0.0)
    assert measured.voltage_v == pytest.approx([11.8] * 6)
    assert measured.temperature_c == pytest.approx([41.0] * 6)
    assert measured.position_rad[1] == pytest.approx(DYNAMIXEL.calibration.joints[1].rad_from_ticks(2050))


def test_the_turns_that_a_servo_has_counted_do_not_show(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(), 0.0)
    dynamixels.take(IDS, {**dynamixel_replies(), 3: dynamixel_replies(2048 - 4096)[3]}, 0.01)
    at_rad = dynamixels.measured(0.01, 0.0).position_rad[2]
    assert at_rad == pytest.approx(DYNAMIXEL.calibration.joints[2].rad_from_ticks(2048))
    assert dynamixels.turns_ticks() == {**dict.fromkeys(IDS, 0), 3: 4096}


def test_an_alert_is_asked_about_until_it_is_known_and_again_later(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(), 0.0)
    assert dynamixels.alerting() == []
    dynamixels.take(IDS, dynamixel_replies(alerting=3), 0.01)
    assert dynamixels.alerting() == [3]
    dynamixels.take_error(3, int(StatusFlag.OVERLOAD))
    assert dynamixels.alerting() == []
    assert dynamixels.measured(0.01, 0.0).status.tolist() == [0, 0, int(StatusFlag.OVERLOAD), 0, 0, 0]
    dynamixels.take(IDS, dynamixel_replies(alerting=3), 0.1)
    assert dynamixels.alerting() == [3]
    assert dynamixels.measured(0.1, 0.0).status[2] == StatusFlag.OVERLOAD


def test_an_error_is_over_when_the_servo_reports_none(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(alerting=3), 0.0)
    dynamixels.take_error(3, int(StatusFlag.OVERLOAD))
    dynamixels.take(IDS, dynamixel_replies(), 0.01)
    assert not dynamixels.measured(0.01, 0.0).status.any()
