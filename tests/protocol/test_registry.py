import json

import pytest

from protocol import registry as tables
from protocol.errors import InterfaceError
from protocol.registry import Registry
from tests.helpers.messages import REGISTRY
from tests.helpers.resources import shared_data

# The reference has them as they were before 2025.
NEWER = {"rosapi_msgs/srv/DeleteParam", "rosapi_msgs/srv/GetParam", "rosapi_msgs/srv/SetParam"}


@pytest.mark.parametrize("name", ["ros2", "ros1"])
def test_the_tables_hold_every_interface_of_the_reference(name):
    reference = json.loads((shared_data() / f"interfaces_{name}.json").read_text())
    table = getattr(tables, f"read_{name}")()
    assert table.keys() >= reference.keys()
    assert [key for key in reference.keys() - NEWER if table[key] != reference[key]] == []


def test_the_ros1_table_adds_seven_messages_for_each_action():
    table = tables.read_ros1()
    actions = [name for name, definition in table.items() if definition["kind"] == "action"]
    assert len(actions) == 20
    for name in (action.replace("/action/", "/msg/") for action in actions):
        for suffix in ("Goal", "Result", "Feedback", "ActionGoal", "ActionResult", "ActionFeedback", "Action"):
            assert table[f"{name}{suffix}"]["kind"] == "msg"


def test_a_name_of_another_spelling_or_kind_is_refused():
    others = ("String", "", "/", "a/b/c/d", "std_msgs/srv/String", "std_msgs/")
    for name in ("std_msgs/string", "Std_msgs/String", *others):
        with pytest.raises(InterfaceError, match="unknown"):
            REGISTRY.message(name)
    for name in ("std_srvs/srv/Trigger", "control_msgs/action/PointHead"):
        with pytest.raises(InterfaceError, match="wanted a message type"):
            REGISTRY.message(name)
    for name in ("std_msgs/String", "std_srvs/srv/SetBool_Goal", "std_srvs/Nothing", "std_srvs/srv/"):
        with pytest.raises(InterfaceError):
            REGISTRY.service(name)
    table = {"a/msg/B": {"kind": "msg", "fields": [["data", "float64[x]"]], "consts": []}}
    with pytest.raises(InterfaceError, match="field data"):
        Registry(table).message("a/B")


def test_a_name_shared_by_message_and_action_is_the_message_in_two_parts():
    assert REGISTRY.canonical("control_msgs/GripperCommand") == "control_msgs/msg/GripperCommand"


def test_every_service_and_action_and_all_that_they_refer_to_can_be_read():
    for chosen in (REGISTRY, REGISTRY.ros1):
        kinds = {"msg": chosen.message, "srv": chosen.service, "action": chosen.action}
        for name in chosen.type_names():
            assert kinds[name.split("/")[1]](name).name == name


def test_a_type_that_exists_only_in_ros1_tells_that_a_client_speaks_it():
    for name in ("std_msgs/Time", "std_msgs/msg/Time", "moveit_msgs/MoveGroupActionGoal"):
        assert REGISTRY.exists_only_in_ros1(name), name
    for name in ("std_msgs/String", "std_msgs/Nothing", "time"):
        assert not REGISTRY.exists_only_in_ros1(name), name
    assert REGISTRY.exists_only_in_ros1("rosapi/Topics", "srv")
    assert not REGISTRY.exists_only_in_ros1("rosapi_msgs/Topics", "srv")


def test_a_type_is_known_as_a_message_or_not():
    assert REGISTRY.knows("std_msgs/String")
    # What is no action has no feedback message.
    for name in (
        "std_srvs/srv/SetBool_FeedbackMessage",
        "no/action/Such_FeedbackMessage",
        "std_srvs/srv/Empty",
        "time",
    ):
        assert not REGISTRY.knows(name)
