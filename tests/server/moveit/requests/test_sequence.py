from __future__ import annotations

import pytest

from planners.problem import MoveItErrorCode
from server.moveit.requests.motion_plan import MAX_ITEMS, requests_of
from tests.helpers.moveit_requests import assert_refused, message

NAMED_START = {"start_state": {"joint_state": {"name": ["elbow_flex"], "position": [0.1]}}}


def read(*items):
    return requests_of(message("MotionSequenceRequest", items=list(items)))


def test_the_items_requests_come_in_their_order() -> None:
    requests = read({"req": {"group_name": "arm"}}, {"req": {"group_name": "gripper"}})
    assert isinstance(requests, list)
    assert [request["group_name"] for request in requests] == ["arm", "gripper"]


def test_the_first_item_may_say_where_it_starts() -> None:
    assert isinstance(read({"req": NAMED_START}, {}), list)


def test_a_start_in_the_middle_is_refused_by_its_place() -> None:
    assert_refused(read({}, {"req": NAMED_START}), MoveItErrorCode.INVALID_MOTION_PLAN, "items[1].req.start_state")


@pytest.mark.parametrize("radius", [0.01, -0.01])
def test_a_blend_radius_is_refused_with_its_reason(radius: float) -> None:
    refusal = read({"blend_radius": radius}, {})
    failure = assert_refused(
        refusal, MoveItErrorCode.INVALID_MOTION_PLAN, "items[0].blend_radius", f"{radius:g}", "rest"
    )
    assert failure.details["item"] == 0


@pytest.mark.parametrize("count", [0, MAX_ITEMS + 1])
def test_no_items_and_too_many_are_refused_with_the_limit(count: int) -> None:
    assert_refused(read(*[{}] * count), MoveItErrorCode.INVALID_MOTION_PLAN, str(count), str(MAX_ITEMS))
