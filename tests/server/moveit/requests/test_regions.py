from __future__ import annotations

import math

import pytest

from planners.problem import MoveItErrorCode
from server.errors import RefusedError
from server.moveit.requests.constraints import LEAST_TOLERANCE_M, regions
from tests.helpers.moveit_requests import (
    BOX,
    CONE,
    CYLINDER,
    SPHERE,
    TIP,
    assert_refused,
    ball,
    constraints,
    context,
    near,
    point,
    region,
)

AT = point(0.3, 0.0, 0.2)


def read(constraint, reading=None):
    (complete,) = constraints(position_constraints=[constraint])["position_constraints"]
    return regions(complete, reading or context(), "here")


def refusal(constraint):
    with pytest.raises(RefusedError) as raised:
        read(constraint)
    return raised.value.failure


def test_a_sphere_is_its_radius_around_its_pose() -> None:
    (one,) = read(ball(0.3, 0.0, 0.2, 0.02))
    assert one.constraint.radius_m == one.within_m == 0.02
    assert near(one.constraint.region, (0.3, 0.0, 0.2))
    assert one.constraint.link == TIP


def test_a_box_is_half_its_edges() -> None:
    (one,) = read(region((BOX, [0.02, 0.02, 0.03]), poses=[AT]))
    assert one.constraint.half_size_m == (0.01, 0.01, 0.015)
    assert one.within_m == 0.01
    assert not one.elongated


def test_a_box_of_unlike_edges_is_not_taken_for_a_ball() -> None:
    (one,) = read(region((BOX, [0.2, 0.02, 0.02]), poses=[AT]))
    assert one.elongated


def test_a_cylinder_is_the_box_within_it() -> None:
    (one,) = read(region((CYLINDER, [0.1, 0.02]), poses=[AT]))
    x, y, z = one.constraint.half_size_m
    assert math.hypot(x, y) == pytest.approx(0.02)
    assert z == 0.05


@pytest.mark.parametrize("primitive", [(SPHERE, [0.0]), (BOX, [0.0, 0.0, 0.0])])
def test_a_region_of_no_size_is_as_exact_as_can_be(primitive) -> None:
    (one,) = read(region(primitive, poses=[AT]))
    assert one.within_m == LEAST_TOLERANCE_M


@pytest.mark.parametrize("primitives", [[], [(0, [])]])
def test_a_pose_without_a_shape_is_a_point_within_the_default_tolerance(primitives) -> None:
    (one,) = read(region(*primitives, poses=[AT]), context(position_tolerance=0.007))
    assert one.within_m == 0.007


def test_every_region_is_told() -> None:
    both = read(region((SPHERE, [0.01]), (SPHERE, [0.02]), poses=[AT, point(0.2, 0.0, 0.2)]))
    assert [one.within_m for one in both] == [0.01, 0.02]


def test_the_offset_of_the_point_is_kept() -> None:
    (one,) = read(ball(0.3, 0.0, 0.2, target_point_offset={"x": 0.01, "y": 0.02, "z": 0.03}))
    assert one.constraint.offset_m == (0.01, 0.02, 0.03)


BAD = {
    "nothing": (region(poses=[]), ("no region",)),
    "no pose": (region((SPHERE, [0.01]), poses=[]), ("no pose",)),
    "too few poses": (region((SPHERE, [0.01]), (SPHERE, [0.01]), poses=[AT]), ("2 primitives", "1 primitive_poses")),
    "cone": (region((CONE, [0.1, 0.1]), poses=[AT]), ("primitives[0].type", "boxes", "not 4")),
    "dimensions": (region((BOX, [0.1]), poses=[AT]), ("3 values", "not 1")),
    "negative": (region((SPHERE, [-0.1]), poses=[AT]), ("radius", "-0.1")),
    "no number": (region((SPHERE, [math.nan]), poses=[AT]), ("radius", "nan")),
    "no point": (ball(math.nan, 0.0, 0.0), ("primitive_poses[0].position.x", "nan")),
    "offset": (ball(0.3, 0.0, 0.2, target_point_offset={"x": math.inf}), ("target_point_offset.x", "inf")),
    "weight": (ball(0.3, 0.0, 0.2, weight=math.nan), ("weight", "nan")),
    "mesh": ({"constraint_region": {"meshes": [{}], "mesh_poses": [AT]}}, ("meshes",)),
}


@pytest.mark.parametrize(("bad", "words"), BAD.values(), ids=BAD.keys())
def test_a_senseless_region_is_refused_by_field_and_value(bad, words) -> None:
    assert_refused(refusal(bad), MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "here.", *words)


def test_an_unknown_link_is_named() -> None:
    assert_refused(refusal(ball(0.3, 0.0, 0.2, link_name="hand")), MoveItErrorCode.INVALID_LINK_NAME, "'hand'")


def test_an_unknown_frame_is_named() -> None:
    failure = refusal(ball(0.3, 0.0, 0.2, header={"frame_id": "moon"}))
    assert_refused(failure, MoveItErrorCode.FRAME_TRANSFORM_FAILURE, "'moon'")
