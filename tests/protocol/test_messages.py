import base64
import copy
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import MessageError
from protocol.messages import Stamp, complete
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY

RECEIVED = Stamp(1700000000, 250)
RECEIVED_TIME = {"sec": 1700000000, "nanosec": 250}


def completed(type_name, value):
    return complete(REGISTRY, type_name, value, RECEIVED)


def refused(type_name, value):
    with pytest.raises(MessageError) as refusal:
        completed(type_name, value)
    return refusal.value


def test_an_empty_message_of_every_type_is_completed_and_is_then_complete():
    assert len(MESSAGE_TYPES) == 340
    for name in MESSAGE_TYPES:
        message = completed(name, {})
        assert list(message) == [field.name for field in REGISTRY.message(name).fields], name
        assert completed(name, message) == message, name


def test_a_completed_message_leaves_its_original_unchanged_and_shares_nothing_with_it():
    came = {"header": {"seq": 1}, "name": ["a"], "position": [1]}
    before = copy.deepcopy(came)
    message = completed("sensor_msgs/JointState", came)
    message["name"].append("b")
    message["header"]["frame_id"] = "x"
    assert came == before


def test_defaults_are_not_shared_between_messages():
    completed("sensor_msgs/JointState", {})["name"].append("a")
    completed("geometry_msgs/PoseWithCovariance", {})["covariance"].append(1.0)
    assert completed("sensor_msgs/JointState", {})["name"] == []
    assert len(completed("geometry_msgs/PoseWithCovariance", {})["covariance"]) == 36


def test_an_unknown_field_is_refused_by_path_with_the_fields_there_are():
    error = refused("geometry_msgs/PoseStamped", {"pose": {"position": {"a": 1}}})
    assert error.path == "pose.position.a"
    assert "(x, y, z)" in str(error)
    assert "no field" in str(refused("std_msgs/Empty", {"data": 1}))


def test_a_wrong_value_deep_inside_is_named_by_its_path():
    points = [{"positions": [0.0, 1.0]}, {"positions": [0.0, "1"]}]
    error = refused("trajectory_msgs/JointTrajectory", {"points": points})
    assert str(error) == "field points[1].positions[1]: wanted float64, got '1'"


# Stamps


@pytest.mark.parametrize(
    ("seconds", "stamp"),
    [
        (2.0**31 - 0.5, Stamp(2**31 - 1, 500_000_000)),
        (2.0**31 + 20.0, Stamp(2**31 - 1, 999_999_999)),
        (1e12, Stamp(2**31 - 1, 999_999_999)),
        (-(2.0**31) - 1.0, Stamp(-(2**31), 0)),
    ],
)
def test_a_time_that_a_stamp_cannot_hold_is_the_nearest_that_it_can(seconds, stamp):
    assert Stamp.from_seconds(seconds) == stamp
    complete(REGISTRY, "std_msgs/Header", {"stamp": Stamp.from_seconds(seconds).as_message()}, RECEIVED)


def test_times_are_zero_or_the_time_of_receipt():
    assert completed("builtin_interfaces/Time", {}) == {"sec": 0, "nanosec": 0}
    assert completed("actionlib_msgs/GoalID", {})["stamp"] == {"sec": 0, "nanosec": 0}
    assert completed("std_msgs/Header", {"stamp": "now"})["stamp"] == RECEIVED_TIME
    assert completed("actionlib_msgs/GoalID", {"stamp": "now"})["stamp"] == RECEIVED_TIME
    assert refused("trajectory_msgs/JointTrajectoryPoint", {"time_from_start": "now"}).path == "time_from_start"


# Spellings of ROS 1


def test_older_spellings_are_understood():
    for stamp in ({"sec": 1, "secs": 2, "nsecs": 5}, {"secs": 2, "nsecs": 5, "sec": 1}):
        assert completed("std_msgs/Header", {"stamp": stamp})["stamp"] == {"sec": 1, "nanosec": 5}
    request = completed("moveit_msgs/MotionPlanRequest", {"cartesian_speed_end_effector_link": "tool"})
    assert request["cartesian_speed_limited_link"] == "tool"
    assert "attempts" not in completed("moveit_msgs/PositionIKRequest", {"attempts": 8})


def test_buttons_that_are_true_or_false_are_numbers_in_a_list_alone():
    assert completed("sensor_msgs/Joy", {"buttons": [True, False, 1], "axes": [True, 0.5]})["buttons"] == [1, 0, 1]
    assert refused("std_msgs/Int32", {"data": True}).path == "data"


# Arrays


def test_a_bounded_array_takes_up_to_its_bound():
    assert completed("shape_msgs/SolidPrimitive", {"dimensions": [1.0] * 3})["dimensions"] == [1.0] * 3
    assert refused("shape_msgs/SolidPrimitive", {"dimensions": [1.0] * 4}).wanted == "at most 3 elements"


def test_nulls_and_infinities_in_an_array_of_floats_come_through():
    position = completed("sensor_msgs/JointState", {"position": [None, 1, math.inf]})["position"]
    assert math.isnan(position[0])
    assert position[1:] == [1.0, math.inf]


def test_octets_come_in_base64():
    assert base64.b64decode(completed("unique_identifier_msgs/UUID", {})["uuid"]) == bytes(16)
    assert refused("unique_identifier_msgs/UUID", {"uuid": "AAAA"}).wanted == "exactly 16 elements"
    assert completed("std_msgs/ByteMultiArray", {"data": "AQI="})["data"] == [1, 2]
    assert completed("std_msgs/ByteMultiArray", {"data": [1, 2]})["data"] == [1, 2]
    assert completed("std_msgs/ByteMultiArray", {})["data"] == []


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
