import base64
import copy
import math
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import TIMEOUT_S
from protocol.errors import LargeMessageError, MessageError
from protocol.messages import MAX_READ_VALUES, MAX_VALUES, ListLimits, MessageBudget, Stamp, complete, values_in
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY

RECEIVED = Stamp(1700000000, 250)
RECEIVED_TIME = {"sec": 1700000000, "nanosec": 250}


def completed(type_name, value, **limits):
    return complete(REGISTRY, type_name, value, RECEIVED, **limits)


def refused(type_name, value, **limits):
    with pytest.raises(MessageError) as refusal:
        completed(type_name, value, **limits)
    return refusal.value


def test_an_empty_message_of_every_type_is_completed_and_is_then_complete():
    assert len(MESSAGE_TYPES) == 340
    for name in MESSAGE_TYPES:
        message = completed(name, {})
        assert list(message) == [field.name for field in REGISTRY.message(name).fields], name
        assert completed(name, message) == message, name


def test_messages_share_nothing_with_what_they_were_completed_from_nor_their_defaults_with_each_other():
    came = {"header": {"seq": 1}, "name": ["a"], "position": [1]}
    before = copy.deepcopy(came)
    message = completed("sensor_msgs/JointState", came)
    message["name"].append("b")
    message["header"]["frame_id"] = "x"
    assert came == before
    completed("sensor_msgs/JointState", {})["name"].append("a")
    completed("geometry_msgs/PoseWithCovariance", {})["covariance"].append(1.0)
    assert completed("sensor_msgs/JointState", {})["name"] == []
    assert len(completed("geometry_msgs/PoseWithCovariance", {})["covariance"]) == 36


def test_what_is_wrong_deep_inside_is_named_by_its_path():
    error = refused("geometry_msgs/PoseStamped", {"pose": {"position": {"a": 1}}})
    assert error.path == "pose.position.a"
    assert "(x, y, z)" in str(error)
    assert "no field" in str(refused("std_msgs/Empty", {"data": 1}))
    points = [{"positions": [0.0, 1.0]}, {"positions": [0.0, "1"]}]
    error = refused("trajectory_msgs/JointTrajectory", {"points": points})
    assert str(error) == "field points[1].positions[1]: wanted float64, got '1'"


def test_a_time_that_a_stamp_cannot_hold_is_the_nearest_that_it_can():
    for seconds, stamp in (
        (2.0**31 - 0.5, Stamp(2**31 - 1, 500_000_000)),
        (2.0**31 + 20.0, Stamp(2**31 - 1, 999_999_999)),
        (1e12, Stamp(2**31 - 1, 999_999_999)),
        (-(2.0**31) - 1.0, Stamp(-(2**31), 0)),
    ):
        assert Stamp.from_seconds(seconds) == stamp
        completed("std_msgs/Header", {"stamp": stamp.as_message()})


def test_times_are_zero_or_the_time_of_receipt():
    assert completed("builtin_interfaces/Time", {}) == {"sec": 0, "nanosec": 0}
    assert completed("actionlib_msgs/GoalID", {})["stamp"] == {"sec": 0, "nanosec": 0}
    assert completed("std_msgs/Header", {"stamp": "now"})["stamp"] == RECEIVED_TIME
    assert completed("actionlib_msgs/GoalID", {"stamp": "now"})["stamp"] == RECEIVED_TIME
    assert refused("trajectory_msgs/JointTrajectoryPoint", {"time_from_start": "now"}).path == "time_from_start"


def test_older_spellings_are_understood():
    for stamp in ({"sec": 1, "secs": 2, "nsecs": 5}, {"secs": 2, "nsecs": 5, "sec": 1}):
        assert completed("std_msgs/Header", {"stamp": stamp})["stamp"] == {"sec": 1, "nanosec": 5}
    request = completed("moveit_msgs/MotionPlanRequest", {"cartesian_speed_end_effector_link": "tool"})
    assert request["cartesian_speed_limited_link"] == "tool"
    assert "attempts" not in completed("moveit_msgs/PositionIKRequest", {"attempts": 8})
    # Buttons may be true or false, but only in a list.
    assert completed("sensor_msgs/Joy", {"buttons": [True, False, 1], "axes": [True, 0.5]})["buttons"] == [1, 0, 1]
    assert refused("std_msgs/Int32", {"data": True}).path == "data"


def test_arrays_take_up_to_their_bounds_nulls_infinities_and_octets_in_base64():
    assert completed("shape_msgs/SolidPrimitive", {"dimensions": [1.0] * 3})["dimensions"] == [1.0] * 3
    assert refused("shape_msgs/SolidPrimitive", {"dimensions": [1.0] * 4}).wanted == "at most 3 elements"
    not_a_number, *others = completed("sensor_msgs/JointState", {"position": [None, 1, math.inf]})["position"]
    assert math.isnan(not_a_number)
    assert others == [1.0, math.inf]
    assert base64.b64decode(completed("unique_identifier_msgs/UUID", {})["uuid"]) == bytes(16)
    assert refused("unique_identifier_msgs/UUID", {"uuid": "AAAA"}).wanted == "exactly 16 elements"
    for sent, octets in (({"data": "AQI="}, [1, 2]), ({"data": [1, 2]}, [1, 2]), ({}, [])):
        assert completed("std_msgs/ByteMultiArray", sent)["data"] == octets


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just("now"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(st.sampled_from(MESSAGE_TYPES), st.data())
def test_any_value_is_completed_or_refused_and_what_is_completed_is_stable(name, data):
    names = [field.name for field in REGISTRY.message(name).fields] or ["data"]
    value = data.draw(st.dictionaries(st.sampled_from(names), json_values, max_size=3))
    try:
        message = completed(name, value)
    except MessageError as error:
        message, path = None, error.path
    if message is None:
        assert path.split(".")[0].split("[")[0] in names
    else:
        assert repr(completed(name, message)) == repr(message)


LIMIT = 1000
NESTED = {"items": [{"req": {"goal_constraints": [{"joint_constraints": [{}] * 10}] * 2}}] * 10}


def test_a_message_that_would_grow_beyond_the_limit_is_refused() -> None:
    for type_name, message in (
        ("geometry_msgs/PoseArray", {"poses": [{}] * LIMIT}),
        ("moveit_msgs/MotionSequenceRequest", {"items": [{}] * LIMIT}),
        ("moveit_msgs/MotionSequenceRequest", NESTED),
        ("moveit_msgs/PlanningSceneWorld", {"collision_objects": [{"meshes": [{}]}] * LIMIT}),
    ):
        with pytest.raises(MessageError, match=f"at most {LIMIT} values in all lists of messages"):
            completed(type_name, message, max_values=LIMIT)
    # Each message has a budget of its own.
    for _ in range(2):
        completed("geometry_msgs/PoseArray", {"poses": [{}] * 100}, max_values=LIMIT)


def test_any_message_has_a_limit_and_the_largest_mesh_is_below_it() -> None:
    with pytest.raises(MessageError, match=f"at most {MAX_VALUES} values in all lists of messages"):
        completed("geometry_msgs/PoseArray", {"poses": [{}] * MAX_VALUES})
    triangles, vertices = [{"vertex_indices": [0, 1, 2]}] * 200_000, [{"x": 0.1, "y": 0.2, "z": 0.3}] * 100_000
    mesh = completed("shape_msgs/Mesh", {"triangles": triangles, "vertices": vertices})
    assert (len(mesh["triangles"]), len(mesh["vertices"])) == (200_000, 100_000)


def test_values_are_counted_with_those_of_the_messages_in_a_message() -> None:
    sizes = {"geometry_msgs/msg/Point": 3, "geometry_msgs/msg/PoseStamped": 10, "std_msgs/msg/Empty": 1}
    assert {name: values_in(REGISTRY, name) for name in sizes} == sizes


def test_spent_budget_is_gone_until_the_next_message_and_threads_have_budgets_of_their_own() -> None:
    budget = MessageBudget()
    budget.take(MAX_VALUES)
    with pytest.raises(MessageError):
        budget.take(1)
    budget.renew("", 1, 1)
    with ThreadPoolExecutor(1) as thread:
        thread.submit(budget.take, 2).result(TIMEOUT_S)
    budget.take(1)


def test_a_message_too_large_to_be_completed_at_once_is_left_to_the_background() -> None:
    poses = {"poses": [{}] * 100}
    completed("geometry_msgs/PoseArray", poses, max_values_at_once=700)
    with pytest.raises(LargeMessageError, match="geometry_msgs/PoseArray"):
        completed("geometry_msgs/PoseArray", poses, max_values_at_once=699)
    with pytest.raises(MessageError, match="at most 699 values"):
        completed("geometry_msgs/PoseArray", poses, max_values=699, max_values_at_once=699)


SEQUENCE = "moveit_msgs/srv/GetMotionSequence_Request"


def test_a_list_beyond_its_limit_is_refused_with_field_limit_and_value() -> None:
    constraints = ListLimits({"moveit_msgs/msg/Constraints.joint_constraints": 3})
    blended = {"req": {"path_constraints": {"joint_constraints": [{}] * 2}}}
    for limits, item, most, field, wanted in (
        (ListLimits({"moveit_msgs/msg/MotionSequenceRequest.items": 2}), {}, 2, "", "2 elements in all, got 3"),
        # A limit is for all lists of the field together; others count by the values they stand for, 43 an item.
        (constraints, blended, 1, "[1].req.path_constraints.joint_constraints", "3 elements in all, got 4"),
        (ListLimits(max_values=10 * 43), {}, 10, "", "430 values in all lists, as they are complete, got more"),
    ):
        completed(SEQUENCE, {"request": {"items": [item] * most}}, limits=limits)
        error = refused(SEQUENCE, {"request": {"items": [item] * (most + 1)}}, limits=limits)
        assert str(error) == f"field request.items{field}: wanted at most {wanted}"


def test_numbers_and_texts_count_as_values() -> None:
    names = ["a"] * MAX_READ_VALUES
    completed("moveit_msgs/srv/GetPositionFK_Request", {"fk_link_names": names}, limits=ListLimits())
    refused("moveit_msgs/srv/GetPositionFK_Request", {"fk_link_names": [*names, "a"]}, limits=ListLimits())


def test_the_elements_of_a_list_of_fixed_length_do_not_count() -> None:
    limits, triangle = ListLimits({"shape_msgs/msg/Mesh.triangles": 2}, max_values=2), {"vertex_indices": [0, 1, 2]}
    completed("shape_msgs/Mesh", {"triangles": [triangle] * 2}, limits=limits)
