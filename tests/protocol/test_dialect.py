import pytest

from protocol.dialect import declared_in_ros1, from_ros1, spell_type, to_ros1
from protocol.errors import InterfaceError
from protocol.messages import Stamp, complete
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY, made_up

NOW = Stamp(1, 2)
SHARED = [name for name in MESSAGE_TYPES if REGISTRY.ros1.knows(name)]


def completed(name, msg):
    return complete(REGISTRY, name, msg, NOW)


def in_ros1(name, msg, sequence_number=0):
    return to_ros1(REGISTRY, name, completed(name, msg), sequence_number)


def assert_spelled_as(registry, type_name, msg):
    """Every field of the type, in its order, and no other."""
    fields = registry.message(type_name).fields
    assert list(msg) == [field.name for field in fields], type_name
    for field in fields:
        if not field.primitive:
            for one in [msg[field.name]] if field.array is None else msg[field.name]:
                assert_spelled_as(registry, field.base, one)


def test_a_message_goes_out_with_the_fields_that_ros1_declares_which_survive_the_way_back():
    assert len(SHARED) == 226
    for name in SHARED:
        spelled = to_ros1(REGISTRY, name, made_up(REGISTRY, name, 1))
        assert_spelled_as(REGISTRY.ros1, name, spelled)
        assert in_ros1(name, from_ros1(REGISTRY, name, spelled)) == spelled, name
    # All their fields are in both generations.
    for name in ("trajectory_msgs/msg/JointTrajectory", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/CameraInfo"):
        message = made_up(REGISTRY, name, 1)
        assert completed(name, from_ros1(REGISTRY, name, to_ros1(REGISTRY, name, message))) == message


def test_only_the_header_of_the_message_itself_is_numbered():
    spelled = in_ros1("nav_msgs/Path", {"header": {"frame_id": "a"}, "poses": [{"header": {}}]}, 2**32 + 7)
    assert spelled["header"] == {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "a"}
    assert spelled["poses"][0]["header"]["seq"] == 0


def test_renamed_fields_take_their_values_along_and_fields_of_one_generation_are_left_out_or_zero():
    spelled = in_ros1("sensor_msgs/CameraInfo", {"d": [1.0], "k": [2.0] * 9})
    assert (spelled["D"], spelled["K"]) == ([1.0], [2.0] * 9)
    spelled = in_ros1("control_msgs/PidState", {"error": 3.0, "p_gain": 5.0})
    assert (spelled["error"], spelled["p_term"]) == (3.0, 0.0)
    assert "p_gain" not in spelled
    # One that exists only in ROS 2 is spelled as if ROS 1 had it.
    assert in_ros1("action_msgs/GoalInfo", {})["stamp"] == {"secs": 0, "nsecs": 0}


def test_a_message_of_ros1_may_be_partial_and_its_quaternion_without_w_is_zero():
    assert from_ros1(REGISTRY, "control_msgs/PidState", {"p_term": 1.0, "error": 2.0}) == {"error": 2.0}
    stamp = from_ros1(REGISTRY, "sensor_msgs/JointState", {"header": {"stamp": {"secs": 5}}})
    assert stamp == {"header": {"stamp": {"sec": 5}}}
    for msg, w in (({"orientation": {"x": 1.0}}, 0.0), ({"orientation": {"w": 0.5}}, 0.5), ({"position": {}}, 0.0)):
        pose = completed("geometry_msgs/Pose", from_ros1(REGISTRY, "geometry_msgs/Pose", msg))
        assert pose["orientation"]["w"] == w, msg


def test_what_cannot_be_translated_is_passed_on_to_the_validation_and_no_message_is_changed():
    for msg in (None, 3, "now", [], {"header": 3}, {"header": {"stamp": "now"}}, {"nonsense": {}}):
        assert from_ros1(REGISTRY, "sensor_msgs/JointState", msg) == msg
    both = {"secs": 1, "sec": 2}
    assert from_ros1(REGISTRY, "builtin_interfaces/Time", both) == both
    message = completed("std_msgs/Header", {})
    to_ros1(REGISTRY, "std_msgs/Header", message)
    assert message == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": ""}


def test_type_names_have_two_parts_in_ros1_and_three_in_ros2():
    for name, spelled in (
        ("std_msgs/msg/String", "std_msgs/String"),
        ("builtin_interfaces/msg/Time", "time"),
        ("rosapi_msgs/srv/Topics", "rosapi/Topics"),
        ("std_srvs/srv/SetBool_Request", "std_srvs/SetBoolRequest"),
        ("control_msgs/action/PointHead", "control_msgs/PointHead"),
        # Only the members of services and actions lose an underscore.
        ("acme_msgs/msg/Odd_Name", "acme_msgs/Odd_Name"),
        ("acme_msgs/srv/Odd_Name_Request", "acme_msgs/Odd_NameRequest"),
    ):
        assert (spell_type(name, "ros1"), spell_type(name, "ros2")) == (spelled, name)


def test_a_time_is_declared_in_ros1_under_any_of_its_names_and_a_type_that_ros1_lacks_as_in_ros2():
    for name in ("builtin_interfaces/Time", "builtin_interfaces/msg/Time", "time"):
        assert declared_in_ros1(REGISTRY, name).name == "time"
    assert declared_in_ros1(REGISTRY, "action_msgs/GoalInfo") == REGISTRY.message("action_msgs/GoalInfo")
    with pytest.raises(InterfaceError):
        declared_in_ros1(REGISTRY, "rcl_interfaces/Nothing")


ROSAPI = [name for name in REGISTRY.type_names() if name.startswith("rosapi_msgs/srv/")]
# In ROS 2 since 2025.
PARAMETERS = ("GetParam_", "SetParam_", "DeleteParam_")
OUTCOME = ("successful", "reason")


def test_every_field_of_rosapi_has_its_counterpart_in_ros1():
    assert len(ROSAPI) > 20
    for name in (f"{service}_{member}" for service in ROSAPI for member in ("Request", "Response")):
        message = made_up(REGISTRY, name, 1)
        spelled = to_ros1(REGISTRY, name, message)
        assert list(spelled) == [field.name for field in declared_in_ros1(REGISTRY, name).fields], name
        newer = OUTCOME if name.partition("_msgs/srv/")[2].startswith(PARAMETERS) else ()
        kept = {field: value for field, value in message.items() if field not in newer}
        assert from_ros1(REGISTRY, name, spelled) == kept, name


LEVELS = [(10, 1), (20, 2), (30, 4), (40, 8), (50, 16)]


def test_each_level_of_a_log_has_its_number_in_either_generation_and_one_between_counts_as_the_lower():
    for ours, theirs in LEVELS:
        assert from_ros1(REGISTRY, "rcl_interfaces/Log", {"level": theirs}) == {"level": ours}
    for ours, theirs in (*LEVELS, (0, 1), (5, 1), (25, 2), (49, 8), (255, 16)):
        assert in_ros1("rcl_interfaces/Log", {"level": ours})["level"] == theirs
    log, log_of_ros1 = REGISTRY.message("rcl_interfaces/Log"), REGISTRY.ros1.message("rosgraph_msgs/Log")
    declared = zip(log.constants, log_of_ros1.constants, strict=True)
    assert [(ours.value, theirs.value) for ours, theirs in declared] == LEVELS
