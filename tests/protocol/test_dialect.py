from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.dialect import declared_in_ros1, from_ros1, spell_type, to_ros1
from protocol.errors import InterfaceError
from protocol.messages import Stamp, complete
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY, made_up

NOW = Stamp(1, 2)
SHARED = [name for name in MESSAGE_TYPES if REGISTRY.ros1.knows(name)]


def assert_spelled_as(registry, type_name, msg):
    """Every field of the type, in its order, and no other."""
    fields = registry.message(type_name).fields
    assert list(msg) == [field.name for field in fields], type_name
    for field in fields:
        if not field.primitive:
            for one in [msg[field.name]] if field.array is None else msg[field.name]:
                assert_spelled_as(registry, field.base, one)


def test_a_message_goes_out_with_the_fields_that_ros1_declares():
    assert len(SHARED) == 226
    for name in SHARED:
        assert_spelled_as(REGISTRY.ros1, name, to_ros1(REGISTRY, name, made_up(REGISTRY, name, 1)))


@given(st.integers(0, 2**32))
def test_fields_of_both_dialects_survive_translation_and_back(seed):
    name = "moveit_msgs/msg/MotionPlanRequest"
    message = made_up(REGISTRY, name, seed)
    for constraint in message["goal_constraints"]:
        for volume in constraint["position_constraints"]:
            for shape in volume["constraint_region"]["primitives"]:
                shape["polygon"] = {"points": []}
    message = without_polygons(message)
    assert complete(REGISTRY, name, from_ros1(REGISTRY, name, to_ros1(REGISTRY, name, message)), NOW) == message


def without_polygons(value):
    if isinstance(value, dict):
        return {key: {"points": []} if key == "polygon" else without_polygons(child) for key, child in value.items()}
    return [without_polygons(child) for child in value] if isinstance(value, list) else value


def test_times_and_headers_are_spelled_in_ros1_style_at_any_depth():
    message = complete(REGISTRY, "tf2_msgs/TFMessage", {"transforms": [{"header": {"frame_id": "a"}}]}, NOW)
    header = to_ros1(REGISTRY, "tf2_msgs/TFMessage", message)["transforms"][0]["header"]
    assert header == {"seq": 0, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "a"}


def test_only_the_header_of_the_message_itself_is_numbered():
    poses = {"header": {}, "poses": [{"header": {}}]}
    spelled = to_ros1(REGISTRY, "nav_msgs/Path", complete(REGISTRY, "nav_msgs/Path", poses, NOW), 2**32 + 7)
    assert (spelled["header"]["seq"], spelled["poses"][0]["header"]["seq"]) == (7, 0)


def test_renamed_fields_take_their_values_along():
    message = complete(REGISTRY, "sensor_msgs/CameraInfo", {"d": [1.0], "k": [2.0] * 9}, NOW)
    spelled = to_ros1(REGISTRY, "sensor_msgs/CameraInfo", message)
    assert (spelled["D"], spelled["K"]) == ([1.0], [2.0] * 9)
    assert (
        complete(REGISTRY, "sensor_msgs/CameraInfo", from_ros1(REGISTRY, "sensor_msgs/CameraInfo", spelled), NOW)
        == message
    )


def test_fields_that_ros1_lacks_are_left_out_and_those_it_has_alone_are_zero():
    message = complete(REGISTRY, "control_msgs/PidState", {"error": 3.0, "p_gain": 5.0}, NOW)
    spelled = to_ros1(REGISTRY, "control_msgs/PidState", message)
    assert (spelled["error"], spelled["p_term"]) == (3.0, 0.0)
    assert "p_gain" not in spelled


def test_a_message_of_ros1_may_be_partial_and_lacks_fields_of_ros2():
    assert from_ros1(REGISTRY, "control_msgs/PidState", {"p_term": 1.0, "error": 2.0}) == {"error": 2.0}
    assert from_ros1(REGISTRY, "sensor_msgs/JointState", {"header": {"stamp": {"secs": 5}}}) == {
        "header": {"stamp": {"sec": 5}}
    }


def test_a_type_that_exists_only_in_ros2_is_spelled_as_if_ros1_had_it():
    message = complete(REGISTRY, "action_msgs/GoalInfo", {}, NOW)
    assert to_ros1(REGISTRY, "action_msgs/GoalInfo", message)["stamp"] == {"secs": 0, "nsecs": 0}


@pytest.mark.parametrize("msg", [None, 3, "now", [], {"header": 3}, {"header": {"stamp": "now"}}, {"nonsense": {}}])
def test_an_untranslatable_message_is_passed_on_to_the_validation(msg):
    assert from_ros1(REGISTRY, "sensor_msgs/JointState", msg) == msg


@pytest.mark.parametrize(
    ("name", "msg", "w"),
    [
        ("geometry_msgs/Pose", {"orientation": {"x": 1.0}}, 0.0),
        ("geometry_msgs/Pose", {"orientation": {"w": 0.5}}, 0.5),
        ("geometry_msgs/Pose", {"position": {"x": 1.0}}, 0.0),
    ],
)
def test_a_quaternion_without_w_is_zero_as_in_ros1(name, msg, w):
    assert complete(REGISTRY, name, from_ros1(REGISTRY, name, msg), NOW)["orientation"]["w"] == w


def test_a_field_in_both_spellings_is_left_to_the_validation():
    both = {"secs": 1, "sec": 2}
    assert from_ros1(REGISTRY, "builtin_interfaces/Time", both) == both


def test_the_message_is_left_as_it_was():
    message = complete(REGISTRY, "std_msgs/Header", {}, NOW)
    to_ros1(REGISTRY, "std_msgs/Header", message)
    assert message == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": ""}


@pytest.mark.parametrize(
    ("name", "spelled"),
    [
        ("std_msgs/msg/String", "std_msgs/String"),
        ("builtin_interfaces/msg/Time", "time"),
        ("rosapi_msgs/srv/Topics", "rosapi/Topics"),
        ("std_srvs/srv/SetBool_Request", "std_srvs/SetBoolRequest"),
        ("control_msgs/action/PointHead", "control_msgs/PointHead"),
    ],
)
def test_type_names_have_two_parts_in_ros1_and_three_in_ros2(name, spelled):
    assert spell_type(name, "ros1") == spelled
    assert spell_type(name, "ros2") == name


def test_only_the_members_of_services_and_actions_lose_an_underscore():
    assert spell_type("acme_msgs/msg/Odd_Name", "ros1") == "acme_msgs/Odd_Name"
    assert spell_type("acme_msgs/srv/Odd_Name_Request", "ros1") == "acme_msgs/Odd_NameRequest"


@pytest.mark.parametrize("name", ["builtin_interfaces/Time", "builtin_interfaces/msg/Time", "time"])
def test_a_time_is_declared_in_ros1_under_any_of_its_names(name):
    assert declared_in_ros1(REGISTRY, name).name == "time"


def test_a_type_that_ros1_lacks_is_declared_as_in_ros2():
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


def record(**fields: Any) -> dict[str, Any]:
    return complete(REGISTRY, "rcl_interfaces/Log", fields, NOW)


@pytest.mark.parametrize(("ours", "theirs"), LEVELS)
def test_each_level_has_its_number_in_either_generation(ours: int, theirs: int) -> None:
    spelled = to_ros1(REGISTRY, "rcl_interfaces/Log", record(level=ours))
    assert spelled["level"] == theirs
    assert from_ros1(REGISTRY, "rcl_interfaces/Log", {"level": theirs}) == {"level": ours}


@pytest.mark.parametrize(("level", "theirs"), [(0, 1), (5, 1), (25, 2), (49, 8), (255, 16)])
def test_a_level_between_two_counts_as_the_lower_one(level: int, theirs: int) -> None:
    assert to_ros1(REGISTRY, "rcl_interfaces/Log", record(level=level))["level"] == theirs


def test_the_levels_are_those_of_both_definitions() -> None:
    ours = [constant.value for constant in REGISTRY.message("rcl_interfaces/Log").constants]
    theirs = [constant.value for constant in REGISTRY.ros1.message("rosgraph_msgs/Log").constants]
    assert list(zip(ours, theirs, strict=True)) == LEVELS
