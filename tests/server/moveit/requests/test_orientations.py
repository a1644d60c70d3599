from __future__ import annotations

import math

import pytest

from planners.problem import MoveItErrorCode
from server.errors import RefusedError
from server.moveit.requests.constraints import LEAST_ORIENTATION_TOLERANCE_RAD
from server.moveit.requests.constraints import UNMEANT_TOLERANCE_RAD, is_binding, is_free, orientation_constraint
from tests.helpers.moveit_requests import SEVEN, TIP, assert_refused, constraints, context, turned

HALF = math.sqrt(0.5)


def read(constraint, reading=None):
    (complete,) = constraints(orientation_constraints=[constraint])["orientation_constraints"]
    return orientation_constraint(complete, reading or context(), "here")


def test_a_constraint_without_fields_is_the_root_links_orientation_of_the_tip() -> None:
    one = read({})
    assert one.link == TIP
    assert one.orientation == (0.0, 0.0, 0.0, 1.0)
    assert one.tolerance_rad == (LEAST_ORIENTATION_TOLERANCE_RAD,) * 3


def test_a_quaternion_of_any_length_is_its_direction() -> None:
    assert read({"orientation": {"z": 3.0, "w": 3.0}}).orientation == pytest.approx((0.0, 0.0, HALF, HALF))


def test_an_orientation_in_a_link_turns_with_the_link() -> None:
    reading = context(start_rad={"shoulder_pan": 0.7})
    fixed = read({"header": {"frame_id": TIP}})
    moved = read({"header": {"frame_id": TIP}}, reading)
    assert moved.orientation != pytest.approx(fixed.orientation)


@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_a_senseless_tolerance_is_refused_by_field_and_value(value: float) -> None:
    with pytest.raises(RefusedError) as raised:
        read(turned((0.1, value, 0.1)))
    assert_refused(
        raised.value.failure, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "absolute_y_axis_tolerance", f"{value:g}"
    )


def test_an_endless_tolerance_leaves_its_axis_free() -> None:
    assert read(turned((0.1, 0.1, math.inf))).tolerance_rad[2] >= math.pi


def test_an_orientation_with_three_free_axes_asks_for_nothing() -> None:
    assert is_free((math.pi, 4.0, 7.0))
    assert not is_free((math.pi, math.pi, 3.0))


@pytest.mark.parametrize("tolerance", [0.0, 1e-4, 1e-3, UNMEANT_TOLERANCE_RAD])
def test_what_clients_fill_in_by_themselves_is_a_wish_for_five_joints(tolerance: float) -> None:
    assert not is_binding(read(turned(tolerance)).tolerance_rad, context())


@pytest.mark.parametrize("tolerance", [0.02, (0.01, 0.01, math.pi), (0.0, 0.5, 0.0)])
def test_a_tolerance_that_somebody_chose_is_kept(tolerance) -> None:
    assert is_binding(read(turned(tolerance)).tolerance_rad, context())


def test_an_arm_with_seven_joints_keeps_every_tolerance() -> None:
    assert is_binding((1e-3, 1e-3, 1e-3), context(SEVEN))
