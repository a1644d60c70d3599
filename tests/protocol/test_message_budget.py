from __future__ import annotations

import time
from typing import Any

import pytest

from protocol.errors import MessageError
from protocol.message_budget import MAX_VALUES, MessageBudget, values_in
from protocol.messages import Stamp, complete
from protocol.registry import Registry

REGISTRY = Registry.load()


def completed(type_name: str, message: dict[str, Any]) -> dict[str, Any]:
    return complete(REGISTRY, type_name, message, Stamp(1, 2))


NESTED = {"items": [{"req": {"goal_constraints": [{"joint_constraints": [{}] * 10_000}] * 2}}] * 10}


@pytest.mark.parametrize(
    ("type_name", "message"),
    [
        ("geometry_msgs/PoseArray", {"poses": [{}] * 300_000}),
        ("moveit_msgs/MotionSequenceRequest", {"items": [{}] * 300_000}),
        ("moveit_msgs/MotionSequenceRequest", NESTED),
        ("moveit_msgs/PlanningSceneWorld", {"collision_objects": [{"meshes": [{}]}] * 300_000}),
    ],
    ids=["poses", "requests", "in many lists", "objects"],
)
def test_a_message_that_would_grow_without_a_bound_is_refused_soon(type_name: str, message: dict[str, Any]) -> None:
    began_s = time.process_time()
    with pytest.raises(MessageError, match=f"at most {MAX_VALUES} values in all lists of messages"):
        completed(type_name, message)
    assert time.process_time() - began_s < 10.0


def test_the_largest_mesh_of_a_scene_is_no_such_message() -> None:
    triangles, vertices = [{"vertex_indices": [0, 1, 2]}] * 200_000, [{"x": 0.1, "y": 0.2, "z": 0.3}] * 100_000
    mesh = completed("shape_msgs/Mesh", {"triangles": triangles, "vertices": vertices})
    assert (len(mesh["triangles"]), len(mesh["vertices"])) == (200_000, 100_000)


def test_each_message_has_a_budget_of_its_own() -> None:
    for _ in range(2):
        completed("geometry_msgs/PoseArray", {"poses": [{}] * (MAX_VALUES // 10)})


def test_values_are_counted_with_those_of_the_messages_in_a_message() -> None:
    sizes = {"geometry_msgs/msg/Point": 3, "geometry_msgs/msg/PoseStamped": 10, "std_msgs/msg/Empty": 1}
    assert {name: values_in(REGISTRY, name) for name in sizes} == sizes


def test_what_is_taken_is_gone_until_the_next_message() -> None:
    budget = MessageBudget()
    budget.take(MAX_VALUES)
    with pytest.raises(MessageError):
        budget.take(1)
    budget.renew()
    budget.take(1)
