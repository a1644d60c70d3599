from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S
from protocol.errors import LargeMessageError, MessageError
from protocol.messages import MAX_VALUES, MessageBudget, Stamp, complete, values_in
from tests.helpers.messages import REGISTRY


def completed(type_name: str, message: dict[str, Any]) -> dict[str, Any]:
    return complete(REGISTRY, type_name, message, Stamp(1, 2))


LIMIT = 1000
NESTED = {"items": [{"req": {"goal_constraints": [{"joint_constraints": [{}] * 10}] * 2}}] * 10}


@pytest.mark.parametrize(
    ("type_name", "message"),
    [
        ("geometry_msgs/PoseArray", {"poses": [{}] * LIMIT}),
        ("moveit_msgs/MotionSequenceRequest", {"items": [{}] * LIMIT}),
        ("moveit_msgs/MotionSequenceRequest", NESTED),
        ("moveit_msgs/PlanningSceneWorld", {"collision_objects": [{"meshes": [{}]}] * LIMIT}),
    ],
    ids=["poses", "requests", "in many lists", "objects"],
)
def test_a_message_that_would_grow_beyond_the_limit_is_refused(type_name: str, message: dict[str, Any]) -> None:
    with pytest.raises(MessageError, match=f"at most {LIMIT} values in all lists of messages"):
        complete(REGISTRY, type_name, message, Stamp(1, 2), max_values=LIMIT)


def test_any_message_has_a_limit_and_the_largest_mesh_is_below_it() -> None:
    with pytest.raises(MessageError, match=f"at most {MAX_VALUES} values in all lists of messages"):
        completed("geometry_msgs/PoseArray", {"poses": [{}] * MAX_VALUES})
    triangles, vertices = [{"vertex_indices": [0, 1, 2]}] * 200_000, [{"x": 0.1, "y": 0.2, "z": 0.3}] * 100_000
    mesh = completed("shape_msgs/Mesh", {"triangles": triangles, "vertices": vertices})
    assert (len(mesh["triangles"]), len(mesh["vertices"])) == (200_000, 100_000)


def test_each_message_has_a_budget_of_its_own() -> None:
    for _ in range(2):
        complete(REGISTRY, "geometry_msgs/PoseArray", {"poses": [{}] * 100}, Stamp(1, 2), max_values=LIMIT)


def test_values_are_counted_with_those_of_the_messages_in_a_message() -> None:
    sizes = {"geometry_msgs/msg/Point": 3, "geometry_msgs/msg/PoseStamped": 10, "std_msgs/msg/Empty": 1}
    assert {name: values_in(REGISTRY, name) for name in sizes} == sizes


def test_spent_budget_is_gone_until_the_next_message() -> None:
    budget = MessageBudget()
    budget.take(MAX_VALUES)
    with pytest.raises(MessageError):
        budget.take(1)
    budget.renew("", MAX_VALUES, MAX_VALUES)
    budget.take(1)


def test_a_message_too_large_to_be_completed_at_once_is_left_to_the_background() -> None:
    poses = {"poses": [{}] * 100}
    complete(REGISTRY, "geometry_msgs/PoseArray", poses, Stamp(1, 2), max_values_at_once=700)
    with pytest.raises(LargeMessageError, match="geometry_msgs/PoseArray"):
        complete(REGISTRY, "geometry_msgs/PoseArray", poses, Stamp(1, 2), max_values_at_once=699)
    with pytest.raises(MessageError, match="at most 699 values"):
        complete(REGISTRY, "geometry_msgs/PoseArray", poses, Stamp(1, 2), max_values=699, max_values_at_once=699)


def test_threads_have_budgets_of_their_own() -> None:
    budget = MessageBudget()
    budget.renew("", 1, 1)
    with ThreadPoolExecutor(1) as thread:
        thread.submit(budget.take, 2).result(TIMEOUT_S)
    budget.take(1)
