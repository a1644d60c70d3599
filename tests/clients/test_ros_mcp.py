"""ros-mcp as it is published, through which language models use robots: every tool of it, over its standard streams.

It wants an environment of its own: ``make test-clients`` makes it and runs this.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from harness.server import RunningServer
from tests.helpers.programs import heard_by

SCENARIO = Path(__file__).with_name("ros_mcp_scenario.py")
PYTHON = Path(__file__).parents[2] / "build" / "ros_mcp" / "bin" / "python"

pytestmark = pytest.mark.skipif(not PYTHON.exists(), reason="ros-mcp is not installed: make test-clients does it")

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]
EXECUTING, SUCCEEDED, CANCELED = 2, 4, 5


@pytest.fixture(scope="module")
def answers(server: RunningServer, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What every tool answered, case by case."""
    return heard_by(PYTHON, SCENARIO, str(server.port), str(tmp_path_factory.mktemp("ros_mcp")))


def test_every_tool_has_a_case(answers: dict[str, Any]) -> None:
    assert sorted(answers["tools"]) == answers["called"]


def test_the_robot_is_found_and_its_release_known(answers: dict[str, Any]) -> None:
    assert "warning" not in answers["connected"]
    assert answers["connected"]["connectivity_test"]["port_check"]["open"]
    assert answers["pinged"]["results"][0]["port_check"]["open"]
    assert answers["version"] == {"version": "2", "distro": "jazzy"}


def test_robots_that_ros_mcp_has_files_of_are_listed_and_this_arm_needs_none(answers: dict[str, Any]) -> None:
    assert "unitree_go2" in answers["robots"]["robot_specifications"]
    assert "not found" in answers["robot"]


def test_topics_are_listed_and_told(answers: dict[str, Any]) -> None:
    types = dict(zip(answers["topics"]["topics"], answers["topics"]["types"], strict=True))
    assert types["/joint_states"] == answers["topic type"]["type"] == "sensor_msgs/msg/JointState"
    assert answers["topic"]["publishers"] == ["/arm"]
    assert "does not exist" in answers["unknown topic"]["error"]


def test_messages_are_told(answers: dict[str, Any]) -> None:
    main = answers["message"]["structure"]["sensor_msgs/JointState"]
    assert list(main["fields"]) == ["header", "name", "position", "velocity", "effort"]
    assert "nobody_msgs" in answers["unknown message"]["error"]


def test_services_are_listed_and_told(answers: dict[str, Any]) -> None:
    assert {"/arm/stop", "/check_goals", "/moveit_goal"} <= set(answers["services"]["services"])
    assert answers["service type"]["type"] == "std_srvs/srv/Trigger"
    assert answers["service"]["type"] == "armbridge_msgs/srv/CheckGoals"
    assert answers["service"]["provider_count"] == 1
    assert "does not exist" in answers["unknown service"]["error"]


def test_nodes_are_listed_and_told(answers: dict[str, Any]) -> None:
    assert "/arm" in answers["nodes"]["nodes"]
    assert "/joint_states" in answers["node"]["publishers"]
    assert "not found" in answers["unknown node"]["error"]


def test_actions_are_listed_and_told(answers: dict[str, Any]) -> None:
    assert {"/moveit_goal", "/gripper_controller/gripper_cmd"} <= set(answers["actions"]["actions"])
    assert answers["action"]["goal"]["fields"] == {"command": "control_msgs/GripperCommand"}
    assert "stalled" in answers["action"]["result"]["fields"]
    assert "position" in answers["action"]["feedback"]["fields"]
    assert {"named", "joints", "pose"} <= answers["action of this server"]["goal"]["fields"].keys()
    assert "control_msgs/action/GripperCommand" in answers["action without a type"]["available_action_types"]
    assert "not found" in answers["unknown action type"]["error"]


def test_a_parameter_is_set_read_and_deleted(answers: dict[str, Any]) -> None:
    assert [answers[f"parameter {when}"]["exists"] for when in ("before", "there", "after")] == [False, True, False]
    assert answers["unknown parameter"]["exists"] is False
    assert answers["parameter set"]["successful"]
    assert answers["parameter"]["value"] == "0.5"
    assert (answers["parameter details"]["exists"], answers["parameter details"]["type"]) == (True, "float")
    assert answers["parameter deleted"]["successful"]


def test_parameters_of_a_node_are_told_to_be_no_service_of_it(answers: dict[str, Any]) -> None:
    # ros-mcp asks the node itself; the nodes of this server have no parameters.
    assert "Service /agent/list_parameters does not exist" in answers["parameters"]["error"]


def test_a_topic_is_subscribed_once_and_for_a_while(answers: dict[str, Any]) -> None:
    assert answers["joint states"]["msg"]["name"] == JOINTS
    summary, *states = map(json.loads, answers["many joint states"])
    assert summary == {"topic": "/joint_states", "collected_count": 5, "status_errors": []}
    assert [state["name"] for state in states] == [JOINTS] * 5


def test_a_topic_of_another_type_is_refused_with_its_type(answers: dict[str, Any]) -> None:
    assert "is already established with type sensor_msgs/msg/JointState" in answers["wrong type"]["error"]


@pytest.mark.parametrize("name", ["compressed", "image"])
def test_a_picture_is_seen(answers: dict[str, Any], name: str) -> None:
    assert answers[f"picture {name}"][0] == "image"
    assert answers["saved picture"] == "image"


def test_what_is_published_arrives(answers: dict[str, Any]) -> None:
    assert answers["goal published"]["success"]
    assert answers["goal reached"][0]["val"] == 1
    assert answers["published at a rate"]["published_count"] > 2
    assert answers["published at a rate"]["errors"] == []
    assert answers["heard"] == [{"data": "hello"}]


def test_goals_are_checked_without_moving(answers: dict[str, Any]) -> None:
    far, near = answers["goals checked"]["result"]["results"]
    assert (far["code"], far["reachable"]) != (1, True)
    assert (near["code"], near["reachable"], near["free"]) == (1, True, True)


def test_an_unknown_service_is_told(answers: dict[str, Any]) -> None:
    assert answers["unknown service called"]["success"] is False
    assert "/nothing does not exist" in answers["unknown service called"]["error"]


def test_one_call_moves_the_arm_and_its_answer_says_how_it_went(answers: dict[str, Any]) -> None:
    assert answers["planned"]["result"]["success"]
    assert answers["moved"]["result"]["code_name"] == "SUCCESS"
    assert answers["moved"]["result"]["message"] == "the arm is there"
    assert answers["called wrongly"]["result"]["success"] is False
    assert "ready" in answers["called wrongly"]["result"]["message"]
    assert answers["called out of reach"]["result"]["success"] is False


def test_goals_are_sent_to_actions(answers: dict[str, Any]) -> None:
    assert (answers["gripped"]["status"], answers["gripped"]["result"]["reached_goal"]) == (SUCCEEDED, True)
    assert (answers["sent"]["status"], answers["sent"]["result"]["success"]) == (SUCCEEDED, True)
    assert "command.position" in answers["wrong goal"]["result"]


def test_a_goal_that_outlasts_its_tool_is_told_and_cancelled_from_another_connection(answers: dict[str, Any]) -> None:
    assert "timed out" in answers["goal in progress"]["error"]
    assert answers["goal in progress"]["feedback_count"] > 0
    assert [goal["status"] for goal in answers["active action"]["active_goals"]][-1] == EXECUTING
    assert [goal["status"] for goal in answers["cancelled action"]["active_goals"]][-1] == CANCELED
    assert answers["stopped"]["result"]["success"]


def test_the_resources_tell_everything_at_once(answers: dict[str, Any]) -> None:
    metadata = answers["ros-mcp://ros-metadata/all"]
    assert metadata["errors"] == []
    assert metadata["summary"]["total_topics"] == len(answers["topics"]["topics"])
    assert answers["ros-mcp://ros-metadata/services/all"]["services"]["/arm/stop"]["type"] == "std_srvs/srv/Trigger"
    assert answers["ros-mcp://ros-metadata/actions/all"]["actions"].keys() == set(answers["actions"]["actions"])
