"""ros-mcp as it is published, through which language models use robots: every tool of it, over its standard streams.

It wants an environment of its own: ``make test-clients`` makes it and runs this.
"""

import base64
import io
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from websockets.sync.client import ClientConnection, connect

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S, wait_until
from tests.clients.agents import Agent, agent_of

PYTHON = ROOT / "build" / "ros_mcp" / "bin" / "python"

pytestmark = pytest.mark.skipif(not PYTHON.exists(), reason="ros-mcp is not installed: make test-clients does it")

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]
JOINT_STATE = {"topic": "/joint_states", "msg_type": "sensor_msgs/msg/JointState"}
EXECUTING, SUCCEEDED, CANCELED = 2, 4, 5

GRIPPER = {"action_name": "/gripper_controller/gripper_cmd", "action_type": "control_msgs/action/GripperCommand"}
MOVE = {"action_name": "/moveit_goal", "action_type": "armbridge_msgs/action/MoveitGoal"}
SERVICE = {"service_name": "/moveit_goal", "service_type": "armbridge_msgs/srv/MoveitGoal", "timeout": 20.0}
TRIGGER = "std_srvs/srv/Trigger"

TURNED = {"name": ["shoulder_pan"], "position": [0.4]}
FAR = {"header": {"frame_id": "base_link"}, "pose": {"position": {"x": 2.0}, "orientation": {"w": 1.0}}}

Ask = Callable[..., Any]


@pytest.fixture(scope="module")
def agent(server: RunningServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Agent]:
    with agent_of(PYTHON, "legacy", "ros-mcp", cwd=tmp_path_factory.mktemp("ros_mcp")) as running:
        yield running


@pytest.fixture(scope="module")
def connected(agent: Agent, server: RunningServer) -> Any:
    """The answer to the connection to the server."""
    return object_of(agent, "connect_to_robot", ip="127.0.0.1", port=server.port, ping_timeout=1.0)


@pytest.fixture
def ask(agent: Agent, connected: Any) -> Ask:
    """Calls a tool; returns the object in its answer, or a list of texts and kinds of content."""
    return lambda tool, **arguments: object_of(agent, tool, **arguments)


def object_of(agent: Agent, tool: str, **arguments: Any) -> Any:
    parts = agent(tool, **arguments).parts
    if len(parts) > 1:
        return parts
    try:
        return json.loads(parts[0])
    except json.JSONDecodeError:
        return parts[0]


@contextmanager
def publisher(server: RunningServer, topic: str, type_name: str, msg: dict[str, Any]) -> Iterator[None]:
    """Publish a message, latched; it is there as long as the block lasts."""
    with connect(f"ws://127.0.0.1:{server.port}") as socket:
        socket.send(json.dumps({"op": "advertise", "topic": topic, "type": type_name, "latch": True}))
        socket.send(json.dumps({"op": "publish", "topic": topic, "msg": msg}))
        yield


@contextmanager
def listener(server: RunningServer, topic: str, type_name: str) -> Iterator[ClientConnection]:
    """Listen as another client does."""
    with connect(f"ws://127.0.0.1:{server.port}") as socket:
        socket.send(json.dumps({"op": "subscribe", "topic": topic, "type": type_name}))
        socket.send(json.dumps({"op": "call_service", "service": "/rosapi/get_time"}))
        socket.recv(timeout=TIMEOUT_S)
        yield socket


def message(socket: ClientConnection) -> Any:
    return json.loads(socket.recv(timeout=TIMEOUT_S))["msg"]


def test_every_tool_is_called_here(agent: Agent) -> None:
    tools = {tool["name"] for tool in agent.end(agent.begin("list_tools"))["tools"]}
    calls = re.findall(r'(?:ask\(|object_of\(agent, )"(\w+)"', Path(__file__).read_text())
    assert tools == set(calls)


def test_the_robot_is_found_and_its_release_known(ask: Ask, connected: Any, server: RunningServer) -> None:
    assert "warning" not in connected
    assert connected["connectivity_test"]["port_check"]["open"]
    pinged = ask("ping_robots", targets=[{"ip": "127.0.0.1", "port": server.port}], ping_timeout=1.0)
    assert pinged["results"][0]["port_check"]["open"]
    assert ask("detect_ros_version") == {"version": "2", "distro": "jazzy"}


def test_robots_that_ros_mcp_has_files_of_are_listed_and_this_arm_needs_none(ask: Ask) -> None:
    assert "unitree_go2" in ask("get_verified_robots_list")["robot_specifications"]
    assert "not found" in ask("get_verified_robot_spec", name="so101")


def test_topics_and_messages_are_listed_and_told(ask: Ask) -> None:
    topics = ask("get_topics")
    types = dict(zip(topics["topics"], topics["types"], strict=True))
    assert types["/joint_states"] == "sensor_msgs/msg/JointState"
    assert ask("get_topic_type", topic="/joint_states")["type"] == "sensor_msgs/msg/JointState"
    assert ask("get_topic_details", topic="/joint_states")["publishers"] == ["/arm"]
    assert "does not exist" in ask("get_topic_type", topic="/nothing")["error"]
    told = ask("get_message_details", message_type="sensor_msgs/msg/JointState")
    fields = told["structure"]["sensor_msgs/JointState"]["fields"]
    assert list(fields) == ["header", "name", "position", "velocity", "effort"]
    assert "nobody_msgs" in ask("get_message_details", message_type="nobody_msgs/msg/Nothing")["error"]


def test_services_and_nodes_are_listed_and_told(ask: Ask) -> None:
    assert {"/arm/stop", "/check_goals", "/moveit_goal"} <= set(ask("get_services")["services"])
    assert ask("get_service_type", service="/arm/stop")["type"] == TRIGGER
    service = ask("get_service_details", service="/check_goals")
    assert (service["type"], service["provider_count"]) == ("armbridge_msgs/srv/CheckGoals", 1)
    assert "does not exist" in ask("get_service_details", service="/nothing")["error"]
    assert "/arm" in ask("get_nodes")["nodes"]
    assert "/joint_states" in ask("get_node_details", node="/arm")["publishers"]
    assert "not found" in ask("get_node_details", node="/nobody")["error"]


def test_actions_are_listed_and_told(ask: Ask) -> None:
    def details(action: str, **of_type: str) -> Any:
        return ask("get_action_details", action=action, **of_type)

    gripper, gripper_type = GRIPPER["action_name"], GRIPPER["action_type"]
    assert {"/moveit_goal", gripper} <= set(ask("get_actions")["actions"])
    action = details(gripper, action_type=gripper_type)
    assert action["goal"]["fields"] == {"command": "control_msgs/GripperCommand"}
    assert "stalled" in action["result"]["fields"]
    assert "position" in action["feedback"]["fields"]
    ours = details("/moveit_goal", action_type=MOVE["action_type"])
    assert {"named", "joints", "pose"} <= ours["goal"]["fields"].keys()
    assert gripper_type in details(gripper)["available_action_types"]
    assert "not found" in details("/a", action_type="nobody_msgs/action/Nothing")["error"]


def test_a_parameter_is_set_read_and_deleted(ask: Ask) -> None:
    name = "/agent:speed"
    assert ask("has_parameter", name=name)["exists"] is False
    assert ask("get_parameter", name=name)["exists"] is False
    assert ask("set_parameter", name=name, value="0.5")["successful"]
    assert ask("get_parameter", name=name)["value"] == "0.5"
    assert ask("has_parameter", name=name)["exists"] is True
    told = ask("get_parameter_details", name=name)
    assert (told["exists"], told["type"]) == (True, "float")
    # ros-mcp asks the node itself; the nodes of this server have no parameters.
    assert "Service /agent/list_parameters does not exist" in ask("get_parameters", node_name="/agent")["error"]
    assert ask("delete_parameter", name=name)["successful"]
    assert ask("has_parameter", name=name)["exists"] is False


def test_a_topic_is_subscribed_once_and_for_a_while(ask: Ask) -> None:
    assert ask("subscribe_once", **JOINT_STATE)["msg"]["name"] == JOINTS
    many = ask("subscribe_for_duration", **JOINT_STATE, max_messages=5, duration=TIMEOUT_S, expects_image="false")
    summary, *states = map(json.loads, many)
    assert summary == {"topic": "/joint_states", "collected_count": 5, "status_errors": []}
    assert [state["name"] for state in states] == [JOINTS] * 5
    wrong = ask("subscribe_once", topic="/joint_states", msg_type="std_msgs/msg/String", timeout=1.0)
    assert "is already established with type sensor_msgs/msg/JointState" in wrong["error"]


@pytest.mark.parametrize("kind", ["CompressedImage", "Image"])
def test_a_picture_is_seen(ask: Ask, server: RunningServer, kind: str) -> None:
    picture = Image.new("RGB", (8, 4), (200, 30, 30))
    jpeg = io.BytesIO()
    picture.save(jpeg, format="JPEG")
    octets = jpeg.getvalue() if kind == "CompressedImage" else picture.tobytes()
    raw = {"width": 8, "height": 4, "step": 24, "encoding": "rgb8"}
    msg = {"data": base64.b64encode(octets).decode(), **({"format": "jpeg"} if kind == "CompressedImage" else raw)}
    topic, type_name = f"/camera/{kind.lower()}", f"sensor_msgs/msg/{kind}"
    with publisher(server, topic, type_name, msg):
        assert ask("subscribe_once", topic=topic, msg_type=type_name, expects_image="true")[0] == "image"
    assert ask("view_saved_image") == "image"


def test_what_is_published_arrives(ask: Ask, server: RunningServer) -> None:
    with listener(server, "/moveit_goal_result", "moveit_msgs/msg/MoveItErrorCodes") as results:
        goal = {"topic": "/moveit_goal_joints", "msg_type": "sensor_msgs/msg/JointState", "msg": TURNED}
        assert ask("publish_once", **goal)["success"]
        assert message(results)["val"] == 1
    with listener(server, "/chatter", "std_msgs/msg/String") as heard:
        text = {"topic": "/chatter", "msg_type": "std_msgs/msg/String", "messages": [{"data": "hello"}]}
        published = ask("publish_for_durations", **text, durations=[0.3], rate_hz=20)
        assert message(heard) == {"data": "hello"}
    assert published["published_count"] > 2
    assert published["errors"] == []


def test_goals_are_checked_without_moving_and_an_unknown_service_is_told(ask: Ask) -> None:
    goals = {"poses": [FAR], "joints": [TURNED]}
    checked = ask("call_service", service_name="/check_goals", service_type="", request=goals)
    far, near = checked["result"]["results"]
    assert (far["code"], far["reachable"]) != (1, True)
    assert (near["code"], near["reachable"], near["free"]) == (1, True, True)
    unknown = ask("call_service", service_name="/nothing", service_type=TRIGGER, request={})
    assert unknown["success"] is False
    assert "/nothing does not exist" in unknown["error"]


def test_one_call_moves_the_arm_and_its_answer_says_how_it_went(ask: Ask) -> None:
    def call(**request: Any) -> Any:
        return ask("call_service", **SERVICE, request=request)["result"]

    assert call(named="ready", plan_only=True)["success"]
    moved = call(named="ready")
    assert (moved["code_name"], moved["message"]) == ("SUCCESS", "the arm is there")
    wrong = call(named="raedy")
    assert wrong["success"] is False
    assert "ready" in wrong["message"]
    assert call(pose=FAR)["success"] is False


def test_goals_are_sent_to_actions(ask: Ask) -> None:
    gripped = ask("send_action_goal", **GRIPPER, goal={"command": {"position": 1.0, "max_effort": 0.0}}, timeout=20.0)
    assert (gripped["status"], gripped["result"]["reached_goal"]) == (SUCCEEDED, True)
    sent = ask("send_action_goal", **MOVE, goal={"named": "home"}, timeout=20.0)
    assert (sent["status"], sent["result"]["success"]) == (SUCCEEDED, True)
    wrong = ask("send_action_goal", **GRIPPER, goal={"command": {"position": "wide"}})
    assert "command.position" in wrong["result"]


def test_a_goal_that_outlasts_its_tool_is_told_and_cancelled_from_another_connection(ask: Ask) -> None:
    def status() -> Any:
        return [goal["status"] for goal in ask("get_action_status", action_name="/moveit_goal")["active_goals"]][-1]

    slowly = {"joints": {"name": ["shoulder_pan"], "position": [-0.8]}, "velocity_scaling": 0.05}
    started = ask("send_action_goal", **MOVE, goal=slowly, timeout=1.0)
    assert "timed out" in started["error"]
    assert started["feedback_count"] > 0
    assert status() == EXECUTING
    ask("cancel_action_goal", action_name="/moveit_goal", goal_id=started["goal_id"])
    wait_until(lambda: status() == CANCELED)
    assert ask("call_service", service_name="/arm/stop", service_type=TRIGGER, request={})["result"]["success"]


def test_the_resources_tell_everything_at_once(agent: Agent, ask: Ask) -> None:
    def read(uri: str) -> Any:
        (content,) = agent.end(agent.begin("read_resource", uri))["contents"]
        return json.loads(content["text"])

    listed = agent.end(agent.begin("list_resources"))["resources"]
    resources = {each["uri"].removeprefix("ros-mcp://ros-metadata/"): read(each["uri"]) for each in listed}
    metadata = resources["all"]
    assert metadata["errors"] == []
    assert metadata["summary"]["total_topics"] == len(ask("get_topics")["topics"])
    assert resources["services/all"]["services"]["/arm/stop"]["type"] == TRIGGER
    assert resources["actions/all"]["actions"].keys() == set(ask("get_actions")["actions"])
