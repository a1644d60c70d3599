from __future__ import annotations

import copy
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import messages
from protocol.errors import LargeMessageError, MessageError
from protocol.messages import BUDGET, MAX_VALUES, MessageBudget, Stamp, complete, quick_way, values_in
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
        thread.submit(budget.take, 2).result(10.0)
    budget.take(1)


RECEIVED = Stamp(1700000000, 250)
MESSAGE_NAMES = [name for name, definition in REGISTRY._table.items() if definition["kind"] == "msg"]

STAMP = {"sec": 1, "nanosec": 2}
HEADER = {"stamp": STAMP, "frame_id": "base_link"}
JOINT_STATE = {"header": HEADER, "name": ["a", "b"], "position": [0.5, 1.5], "velocity": [], "effort": []}
POINT = {"positions": [1.0], "velocities": [], "accelerations": [], "effort": [], "time_from_start": STAMP}
TRAJECTORY = {"header": HEADER, "joint_names": ["a"], "points": [POINT, POINT]}

odd_values = st.sampled_from(
    [
        None,
        True,
        0,
        -1,
        1.0,
        0.5,
        2**31,
        2**63,
        2**64,
        10**400,
        1e39,
        float("nan"),
        "",
        "now",
        "AA==",
        [],
        [1],
        [""],
        {},
    ]
)


def quick(type_name, value):
    BUDGET.renew(type_name, MAX_VALUES, MAX_VALUES)
    return quick_way(REGISTRY, type_name)(value)


def slow(type_name, value):
    BUDGET.renew(type_name, MAX_VALUES, MAX_VALUES)
    return messages._message_shape(REGISTRY, type_name).complete(value, RECEIVED)


def sample(type_name):
    """A complete message with one element in every array that may have one."""
    message = slow(type_name, {})
    for field in REGISTRY.message(type_name).fields:
        if field.array is not None and field.array.min_length == 0 and type(message[field.name]) is list:
            element = {"string": "x", "bool": True}.get(field.base, 1) if field.primitive else slow(field.base, {})
            message[field.name] = [element]
    return slow(type_name, message)


def places(value):
    """Every container in a message with every key of it."""
    members = value.items() if type(value) is dict else enumerate(value)
    for key, member in members:
        yield value, key
        if type(member) in (dict, list):
            yield from places(member)


@pytest.mark.parametrize("name", MESSAGE_NAMES)
def test_of_every_type_a_complete_message_is_taken_as_it_is_or_left_to_the_slow_way(name):
    message = sample(name)
    taken = quick(name, message)
    assert taken is None or (repr(taken) == repr(message) and taken is not message)


@pytest.mark.parametrize(
    ("name", "message"),
    [("sensor_msgs/JointState", JOINT_STATE), ("trajectory_msgs/JointTrajectory", TRAJECTORY), ("std_msgs/Empty", {})],
)
def test_the_most_common_messages_go_the_quick_way(name, message):
    assert quick(name, message) == message


@given(st.sampled_from(MESSAGE_NAMES), st.data())
def test_the_quick_way_and_the_slow_way_complete_messages_equally(name, data):
    message = copy.deepcopy(sample(name))
    spots = list(places(message))
    if spots:
        container, key = data.draw(st.sampled_from(spots))
        container[key] = data.draw(odd_values)
    taken = quick(name, message)
    if taken is not None:
        assert repr(taken) == repr(slow(name, message))


@given(st.sampled_from(MESSAGE_NAMES), st.data())
def test_missing_fields_are_filled_in_as_on_the_slow_way(name, data):
    message = copy.deepcopy(sample(name))
    for _ in range(3):
        spots = [spot for spot in places(message) if type(spot[0]) is dict]
        if spots:
            container, key = data.draw(st.sampled_from(spots))
            del container[key]
    taken = quick(name, message)
    if taken is not None:
        assert repr(taken) == repr(slow(name, message))


@pytest.mark.parametrize("name", ["geometry_msgs/Pose", "moveit_msgs/CollisionObject", "moveit_msgs/RobotTrajectory"])
def test_a_message_without_a_header_to_stamp_may_leave_out_anything_else(name):
    message = sample(name)
    sparse = {
        key: value
        for key, value in message.items()
        if key in ("header", "joint_trajectory", "multi_dof_joint_trajectory")
    }
    assert quick(name, sparse) == slow(name, sparse)


def test_a_header_without_stamp_is_left_to_the_slow_way_which_knows_the_time():
    assert quick("std_msgs/Header", {"frame_id": "a"}) is None
    assert quick("sensor_msgs/JointState", {"name": ["a"]}) is None


def test_filled_in_values_are_not_shared():
    first, second = (quick("shape_msgs/SolidPrimitive", {}) for _ in range(2))
    first["dimensions"].append(1.0)
    first["polygon"]["points"].append({})
    assert second == slow("shape_msgs/SolidPrimitive", {})


def test_nothing_of_what_came_is_shared():
    taken = quick("trajectory_msgs/JointTrajectory", TRAJECTORY)
    mine = {id(container[key]) for container, key in places(TRAJECTORY) if type(container[key]) in (dict, list)}
    theirs = {id(container[key]) for container, key in places(taken) if type(container[key]) in (dict, list)}
    assert not mine & theirs


def test_integers_that_javascript_writes_for_floats_are_taken_as_floats():
    assert repr(quick("geometry_msgs/Point", {"x": 1, "y": 0.5, "z": -2})) == "{'x': 1.0, 'y': 0.5, 'z': -2.0}"


@pytest.mark.parametrize(
    "value",
    [
        {"sec": 1, "nanosec": 2, "more": 3},
        {"sec": 1, "more": 3},
        {"secs": 1, "nsecs": 2},
        {"sec": 1, "nanosec": -1},
        {"sec": True, "nanosec": 2},
        "now",
        None,
        [1, 2],
    ],
)
def test_an_invalid_message_is_left_to_the_slow_way(value):
    assert quick("builtin_interfaces/Time", value) is None


def test_an_array_of_the_wrong_length_is_left_to_the_slow_way():
    imu = sample("sensor_msgs/Imu")
    assert quick("sensor_msgs/Imu", imu) is not None
    imu["orientation_covariance"].pop()
    assert quick("sensor_msgs/Imu", imu) is None
    with pytest.raises(MessageError, match="exactly 9 elements"):
        slow("sensor_msgs/Imu", imu)


def test_octets_which_have_two_spellings_are_left_to_the_slow_way():
    assert quick("sensor_msgs/Image", sample("sensor_msgs/Image")) is None
    assert quick("std_msgs/UInt8MultiArray", slow("std_msgs/UInt8MultiArray", {}) | {"data": [1, 2]}) is None


def test_a_float_beyond_single_precision_is_left_to_the_slow_way():
    assert quick("geometry_msgs/Point32", {"x": 1e38, "y": 0.0, "z": 0.0}) is not None
    assert quick("geometry_msgs/Point32", {"x": 1e39, "y": 0.0, "z": 0.0}) is None
