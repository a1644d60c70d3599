import json

import pytest

from protocol import registry
from protocol.errors import InterfaceError
from protocol.registry import Registry
from tests.helpers.resources import shared_data

# The reference has them as they were before 2025.
NEWER = {"rosapi_msgs/srv/DeleteParam", "rosapi_msgs/srv/GetParam", "rosapi_msgs/srv/SetParam"}


@pytest.mark.parametrize(("read", "name"), [(registry.read_ros2, "ros2"), (registry.read_ros1, "ros1")])
def test_the_tables_hold_every_interface_of_the_reference(read, name):
    reference = json.loads((shared_data() / f"interfaces_{name}.json").read_text())
    table = read()
    assert table.keys() >= reference.keys()
    assert {key: table[key] for key in reference.keys() - NEWER} == {
        key: reference[key] for key in reference.keys() - NEWER
    }


def test_the_ros1_table_adds_seven_messages_for_each_action():
    table = registry.read_ros1()
    actions = [name for name, definition in table.items() if definition["kind"] == "action"]
    assert len(actions) == 20
    for action in actions:
        package, _, name = action.split("/")
        for suffix in ("Goal", "Result", "Feedback", "ActionGoal", "ActionResult", "ActionFeedback", "Action"):
            assert table[f"{package}/msg/{name}{suffix}"]["kind"] == "msg"


@pytest.mark.parametrize(
    "name", ["std_msgs/string", "Std_msgs/String", "String", "", "/", "a/b/c/d", "std_msgs/srv/String", "std_msgs/"]
)
def test_a_name_that_does_not_match_to_the_letter_is_refused(registry, name):
    with pytest.raises(InterfaceError, match="unknown"):
        registry.message(name)


@pytest.mark.parametrize("name", ["std_srvs/srv/Trigger", "control_msgs/action/PointHead"])
def test_services_and_actions_are_no_message_types(registry, name):
    with pytest.raises(InterfaceError, match="wanted a message type"):
        registry.message(name)


def test_a_name_shared_by_message_and_action_is_the_message_in_two_parts(registry):
    assert registry.canonical("control_msgs/GripperCommand") == "control_msgs/msg/GripperCommand"


def test_a_field_type_that_cannot_be_read_is_refused_by_name():
    table = {"a/msg/B": {"kind": "msg", "fields": [["data", "float64[x]"]], "consts": []}}
    with pytest.raises(InterfaceError, match="field data"):
        Registry(table).message("a/B")


@pytest.mark.parametrize("generation", ["ros2", "ros1"])
def test_every_service_and_action_and_all_that_they_refer_to_can_be_read(registry, generation):
    chosen = registry if generation == "ros2" else registry.ros1
    kinds = {"msg": chosen.message, "srv": chosen.service, "action": chosen.action}
    for name in chosen.type_names():
        assert kinds[name.split("/")[1]](name).name == name


@pytest.mark.parametrize("name", ["std_msgs/String", "std_srvs/srv/SetBool_Goal", "std_srvs/Nothing", "std_srvs/srv/"])
def test_a_type_that_is_no_service_is_refused_as_one(registry, name):
    with pytest.raises(InterfaceError):
        registry.service(name)


@pytest.mark.parametrize(
    ("name", "kind", "only"),
    [
        ("std_msgs/Time", "msg", True),
        ("std_msgs/msg/Time", "msg", True),
        ("moveit_msgs/MoveGroupActionGoal", "msg", True),
        ("rosapi/Topics", "srv", True),
        ("rosapi_msgs/Topics", "srv", False),
        ("std_msgs/String", "msg", False),
        ("std_msgs/Nothing", "msg", False),
        ("time", "msg", False),
    ],
)
def test_a_type_that_exists_only_in_ros1_tells_that_a_client_speaks_it(registry, name, kind, only):
    assert registry.exists_only_in_ros1(name, kind) is only


@pytest.mark.parametrize(("name", "known"), [("std_msgs/String", True), ("std_srvs/srv/Empty", False), ("time", False)])
def test_a_type_is_known_as_a_message_or_not(registry, name, known):
    assert registry.knows(name) is known


@pytest.mark.parametrize("name", ["std_srvs/srv/SetBool_FeedbackMessage", "no/action/Such_FeedbackMessage"])
def test_what_is_no_action_has_no_feedback_message(registry, name):
    assert not registry.knows(name)
