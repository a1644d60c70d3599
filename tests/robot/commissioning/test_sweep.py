from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import MAX_TICK, TICKS_PER_TURN
from robot.commissioning.sweep import (
    LEAST_SWEEP_TICKS,
    MIDDLE_TICK,
    WIDEST_SWEEP_TICKS,
    Sweep,
    expected_width,
    met_both_stops,
    place,
    place_free,
)
from robot.description.servo_table import MAX_HOMING_OFFSET
from robot.errors import CalibrationError
from tests.helpers.robots import SO101_SERVOS

ELBOW = next(servo for servo in SO101_SERVOS if servo.joint == "elbow_flex")
ROLL = next(servo for servo in SO101_SERVOS if servo.turns_freely)

LARGEST_OFFSET = MAX_HOMING_OFFSET["feetech"]


def swept(encoder_stops, offset, start_share=0.5, servo=ELBOW):
    """A hand's sweep of one joint between two stops of its encoder, as a servo with an offset tells it: in one turn."""
    low, high = encoder_stops
    start = round(low + start_share * (high - low))

    def reading(encoder):
        return (encoder - offset) % TICKS_PER_TURN

    sweep = Sweep({servo.servo_id: reading(start)})
    way = [*range(start, low, -300), low, *range(low, high, 300), high, *range(high, start, -300), start]
    for encoder in way:
        sweep.add({servo.servo_id: reading(encoder)})
    return sweep


@given(
    st.integers(-5000, 5000),
    st.integers(LEAST_SWEEP_TICKS, WIDEST_SWEEP_TICKS),
    st.integers(-LARGEST_OFFSET, LARGEST_OFFSET),
    st.floats(0.0, 1.0),
)
def test_wherever_the_stops_are_the_placed_range_never_crosses_the_seam(lower_stop, width, offset, start_share):
    sweep = swept((lower_stop, lower_stop + width), offset, start_share)
    placed = place(ELBOW, sweep, offset, recentre=True)
    assert abs(placed.homing_offset) <= LARGEST_OFFSET
    assert 0 <= placed.range_min < placed.range_max <= MAX_TICK
    # The same stops: an encoder's position less the offset, within the turn.
    assert placed.range_max - placed.range_min == width
    assert (lower_stop - placed.homing_offset - placed.range_min) % TICKS_PER_TURN == 0
    assert abs((placed.range_min + placed.range_max) / 2 - MIDDLE_TICK) <= 1


@given(
    st.integers(-5000, 5000),
    st.integers(-LARGEST_OFFSET, LARGEST_OFFSET),
    st.floats(0.0, 1.0),
)
@pytest.mark.parametrize(
    ("width", "reason"),
    [
        (0, "was moved by 0 ticks"),
        (LEAST_SWEEP_TICKS - 1, "was moved by"),
        (WIDEST_SWEEP_TICKS + 1, "no stops within a turn"),
        (MAX_TICK + 800, "no stops within a turn"),
    ],
)
def test_a_joint_that_hardly_moved_or_turned_round_is_refused_with_the_reason(
    width, reason, lower_stop, offset, start_share
):
    sweep = swept((lower_stop, lower_stop + width), offset, start_share)
    with pytest.raises(CalibrationError, match=reason):
        place(ELBOW, sweep, offset, recentre=True)


@given(st.integers(0, MAX_TICK), st.integers(-LARGEST_OFFSET, LARGEST_OFFSET))
def test_wherever_a_free_joint_shows_its_middle_the_offset_puts_it_in_the_middle(encoder, offset):
    middle = (encoder - offset) % TICKS_PER_TURN
    placed = place_free(ROLL, middle, offset, recentre=True)
    assert abs((encoder - placed.homing_offset) % TICKS_PER_TURN - MIDDLE_TICK) <= 1
    assert abs(placed.homing_offset) <= LARGEST_OFFSET
    assert (placed.range_min, placed.range_max) == (0, MAX_TICK)


def test_without_a_new_offset_the_range_is_what_the_servo_reports():
    placed = place(ELBOW, swept((937, 3137), offset=37), 37, recentre=False)
    assert (placed.homing_offset, placed.range_min, placed.range_max) == (37, 900, 3100)


def test_a_range_across_the_seam_is_refused_and_a_new_offset_is_named_as_the_remedy():
    with pytest.raises(CalibrationError, match=r"crosses the seam .*--write-servos"):
        place(ELBOW, swept((-700, 1300), offset=0), 0, recentre=False)


def test_a_free_joint_off_the_formats_middle_needs_a_new_offset():
    assert place_free(ROLL, 2100, 5, recentre=False).homing_offset == 5
    with pytest.raises(CalibrationError, match="its middle is tick 2500"):
        place_free(ROLL, 2500, 0, recentre=False)


def test_a_joint_met_both_stops_when_it_covered_most_of_what_the_model_has():
    width = expected_width(ELBOW)
    assert met_both_stops(ELBOW, round(0.85 * width))
    assert not met_both_stops(ELBOW, round(0.75 * width))


def test_a_free_joint_with_stops_is_told_from_one_that_turned_round():
    # The stops of the SO-101's wrist.
    assert met_both_stops(ROLL, 3981 - 113)
    assert not met_both_stops(ROLL, MAX_TICK)
    assert met_both_stops(replace(ROLL, turns_freely=False), MAX_TICK)
