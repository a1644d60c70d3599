import json

import pytest

from protocol import tables
from tests.helpers.shared import shared_data


@pytest.mark.parametrize(("read", "name"), [(tables.read_ros2, "ros2"), (tables.read_ros1, "ros1")])
def test_the_tables_hold_every_interface_of_the_reference(read, name):
    reference = json.loads((shared_data() / f"interfaces_{name}.json").read_text())
    table = read()
    assert {key: table[key] for key in reference} == reference


def test_what_the_ros1_table_has_beyond_the_reference_are_seven_messages_an_action():
    table = tables.read_ros1()
    actions = [name for name, definition in table.items() if definition["kind"] == "action"]
    assert len(actions) == 13
    for action in actions:
        package, _, name = action.split("/")
        for suffix in ("Goal", "Result", "Feedback", "ActionGoal", "ActionResult", "ActionFeedback", "Action"):
            assert table[f"{package}/msg/{name}{suffix}"]["kind"] == "msg"


def test_an_action_goal_of_ros1_is_header_id_and_goal():
    fields = tables.read_ros1()["control_msgs/msg/PointHeadActionGoal"]["fields"]
    assert fields == [
        ["header", "std_msgs/Header"],
        ["goal_id", "actionlib_msgs/GoalID"],
        ["goal", "control_msgs/PointHeadGoal"],
    ]
