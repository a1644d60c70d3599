from __future__ import annotations

import struct

import numpy as np
import pytest

from robot.hardware.dynamixel.packets import ALERT, StatusFrame
from robot.hardware.dynamixel.readings import (
    ASK_SILENT_EVERY,
    MISSES_UNTIL_LAST,
    ServoWatch,
)
from robot.hardware.dynamixel.registers import MOTION_BYTES
from robot.hardware.dynamixel.servo_map import ServoMap
from robot.hardware.interface import StatusFlag
from tests.helpers.dynamixel import BOUNDS, CALIBRATION

SERVOS = ServoMap(CALIBRATION, BOUNDS)


def frame(servo_id: int, ticks: int = 2048, error: int = 0, *, whole: bool = True) -> StatusFrame:
    data = struct.pack("<hhiiiiHB", -443, 350, 10, ticks, 0, 0, 118, 41)
    return StatusFrame(servo_id, error, data if whole else data[:MOTION_BYTES])


def answered(watch: ServoWatch, *silent: int, now_s: float = 0.0, blinded: bool = False) -> list[int]:
    """One cycle in which all but some servos answer; returns who was asked.

    Args:
        watch: the watch.
        silent: servos that do not answer.
        now_s: time of the cycle [s].
        blinded: whether the servos behind a silent one wait for its reply in vain.
    """
    asked = watch.ids_to_ask()
    first = next((at for at, servo in enumerate(asked) if servo in silent), len(asked))
    speaking = asked[:first] if blinded else [servo for servo in asked if servo not in silent]
    watch.take(asked, {servo: frame(servo) for servo in speaking}, now_s)
    return asked


@pytest.fixture
def watch() -> ServoWatch:
    return ServoWatch(SERVOS)


def test_readings_are_incomplete_without_supply_and_temperature(watch: ServoWatch) -> None:
    watch.take(SERVOS.ids, {servo: frame(servo, whole=False) for servo in SERVOS.ids}, 0.0)
    assert not watch.complete


def test_readings_are_in_the_units_of_the_controller(watch: ServoWatch) -> None:
    answered(watch)
    measured = watch.measured(0.25, 7.0)
    assert measured.position_rad == pytest.approx([joint.rad_from_ticks(2048) for joint in CALIBRATION.joints])
    assert measured.velocity_rad_s[:5] == pytest.approx([2.29 * 2 * np.pi / 60] * 5)
    assert measured.load == pytest.approx([-443 / 885] * 6)
    assert np.isnan(measured.current_a[:2]).all()
    assert measured.current_a[2:] == pytest.approx([0.35] * 4)
    assert measured.voltage_v == pytest.approx([11.8] * 6)
    assert measured.temperature_c == pytest.approx([41.0] * 6)
    assert measured.age_s == pytest.approx([0.25] * 6)
    assert measured.stamp_s == 7.0


def test_supply_and_temperature_are_kept_between_their_readings(watch: ServoWatch) -> None:
    answered(watch)
    watch.take(SERVOS.ids, {servo: frame(servo, 2050, whole=False) for servo in SERVOS.ids}, 0.01)
    measured = watch.measured(0.01, 0.0)
    assert measured.voltage_v == pytest.approx([11.8] * 6)
    assert measured.position_rad[1] == pytest.approx(CALIBRATION.joints[1].rad_from_ticks(2050))


def test_the_turns_that_a_servo_has_counted_do_not_show(watch: ServoWatch) -> None:
    answered(watch)
    turned = {servo: frame(servo, 2048 - 4096 if servo == 3 else 2048) for servo in SERVOS.ids}
    watch.take(SERVOS.ids, turned, 0.01)
    assert watch.measured(0.01, 0.0).position_rad[2] == pytest.approx(CALIBRATION.joints[2].rad_from_ticks(2048))
    assert (watch.turns_ticks(3), watch.turns_ticks(4)) == (4096, 0)


@pytest.mark.parametrize("blinded", [False, True])
def test_a_silent_servo_silences_the_others_for_a_few_cycles_at_most(watch: ServoWatch, blinded: bool) -> None:
    answered(watch)
    for cycle in range(1, 4 * ASK_SILENT_EVERY):
        answered(watch, 2, now_s=0.01 * cycle, blinded=blinded)
        others = np.delete(watch.measured(0.01 * cycle, 0.0).age_s, 1)
        assert others.max() <= 0.01 * MISSES_UNTIL_LAST + 1e-9
    assert watch.is_silent(2)
    assert not any(watch.is_silent(servo) for servo in SERVOS.ids if servo != 2)


def test_a_servo_that_misses_its_turn_is_asked_behind_the_others(watch: ServoWatch) -> None:
    answered(watch)
    for _ in range(MISSES_UNTIL_LAST):
        answered(watch, 2)
    assert answered(watch, 2) == [1, 3, 4, 5, 6, 2]
    answered(watch)
    assert answered(watch) == [1, 2, 3, 4, 5, 6]


def test_an_alert_is_asked_about_until_it_is_known_and_again_later(watch: ServoWatch) -> None:
    answered(watch)
    assert watch.alerting() == []
    alerted = {servo: frame(servo, error=ALERT if servo == 3 else 0) for servo in SERVOS.ids}
    watch.take(SERVOS.ids, alerted, 0.01)
    assert watch.alerting() == [3]
    watch.take_hardware_error(3, 0x20)
    assert watch.alerting() == []
    assert watch.measured(0.01, 0.0).status.tolist() == [0, 0, int(StatusFlag.OVERLOAD), 0, 0, 0]
    watch.take(SERVOS.ids, dict(alerted), 0.1)
    assert watch.alerting() == [3]
    assert watch.measured(0.1, 0.0).status[2] == StatusFlag.OVERLOAD


def test_a_hardware_error_is_over_when_the_servo_reports_none(watch: ServoWatch) -> None:
    watch.take(SERVOS.ids, {servo: frame(servo, error=ALERT) for servo in SERVOS.ids}, 0.0)
    watch.take_hardware_error(3, 0x20)
    answered(watch, now_s=0.01)
    assert not watch.measured(0.01, 0.0).status.any()
