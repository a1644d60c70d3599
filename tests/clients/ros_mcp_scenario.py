"""What a language model does with ros-mcp, tool by tool; prints one JSON object: the tools, and case -> its answer.

ros-mcp is started as its users' programs start it: a child process that speaks MCP over its standard streams.

Usage: python ros_mcp_scenario.py PORT FOLDER, with a folder for the pictures that ros-mcp saves
"""

import asyncio
import base64
import io
import json
import sys
import threading
from pathlib import Path
from typing import Any

import websocket
from mcp import ClientSession, StdioServerParameters
from mcp.client.stdio import stdio_client
from PIL import Image

GRIPPER = ("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand")

TURNED = {"name": ["shoulder_pan"], "position": [0.4]}


class Agent:
    """One session with ros-mcp."""

    def __init__(self, session: ClientSession) -> None:
        self._session = session
        self.called: set[str] = set()
        self.answers: dict[str, Any] = {}

    async def call(self, case: str, tool: str, /, **arguments: Any) -> Any:
        """Call a tool and keep its answer: the object that it returned, or a list of texts and kinds of content."""
        self.called.add(tool)
        result = await self._session.call_tool(tool, arguments)
        texts = [part.text if part.type == "text" else part.type for part in result.content]
        answer: Any = texts
        if len(texts) == 1:
            try:
                answer = json.loads(texts[0])
            except json.JSONDecodeError:
                answer = texts[0]
        self.answers[case] = answer
        return answer


def camera(port: int) -> websocket.WebSocket:
    """Publish a picture in two ways, latched; it is there as long as the connection is."""
    picture = Image.new("RGB", (8, 4), (200, 30, 30))
    jpeg = io.BytesIO()
    picture.save(jpeg, format="JPEG")
    compressed = {"format": "jpeg", "data": base64.b64encode(jpeg.getvalue()).decode()}
    pixels = base64.b64encode(picture.tobytes()).decode()
    raw = {"width": 8, "height": 4, "step": 24, "encoding": "rgb8", "data": pixels}
    socket = websocket.create_connection(f"ws://127.0.0.1:{port}")
    for topic, type_name, msg in (
        ("/camera/compressed", "sensor_msgs/msg/CompressedImage", compressed),
        ("/camera/image", "sensor_msgs/msg/Image", raw),
    ):
        socket.send(json.dumps({"op": "advertise", "topic": topic, "type": type_name, "latch": True}))
        socket.send(json.dumps({"op": "publish", "topic": topic, "msg": msg}))
    return socket


def first_message(port: int, topic: str, type_name: str) -> tuple[threading.Event, list[Any]]:
    """Listen as another client does; the event is set by the first message."""
    socket = websocket.create_connection(f"ws://127.0.0.1:{port}", timeout=30)
    socket.send(json.dumps({"op": "subscribe", "topic": topic, "type": type_name}))
    heard: list[Any] = []
    event = threading.Event()

    def listen() -> None:
        heard.append(json.loads(socket.recv())["msg"])
        event.set()
        socket.close()

    threading.Thread(target=listen, daemon=True).start()
    return event, heard


async def look(agent: Agent, port: int) -> None:
    """Call every tool that only asks."""
    call = agent.call
    await call("connected", "connect_to_robot", ip="127.0.0.1", port=port, ping_timeout=1.0)
    await call("pinged", "ping_robots", targets=[{"ip": "127.0.0.1", "port": port}], ping_timeout=1.0)
    await call("version", "detect_ros_version")
    await call("robots", "get_verified_robots_list")
    await call("robot", "get_verified_robot_spec", name="so101")
    await call("topics", "get_topics")
    await call("topic type", "get_topic_type", topic="/joint_states")
    await call("unknown topic", "get_topic_type", topic="/nothing")
    await call("topic", "get_topic_details", topic="/joint_states")
    await call("message", "get_message_details", message_type="sensor_msgs/msg/JointState")
    await call("unknown message", "get_message_details", message_type="nobody_msgs/msg/Nothing")
    await call("services", "get_services")
    await call("service type", "get_service_type", service="/arm/stop")
    await call("service", "get_service_details", service="/check_goals")
    await call("unknown service", "get_service_details", service="/nothing")
    await call("nodes", "get_nodes")
    node = agent.answers["topic"]["publishers"][0]
    await call("node", "get_node_details", node=node)
    await call("unknown node", "get_node_details", node="/nobody")
    await call("actions", "get_actions")
    await call("action", "get_action_details", action=GRIPPER[0], action_type=GRIPPER[1])
    await call("action without a type", "get_action_details", action=GRIPPER[0])
    await call("unknown action type", "get_action_details", action="/a", action_type="nobody_msgs/action/Nothing")
    await call(
        "action of this server",
        "get_action_details",
        action="/moveit_goal",
        action_type="armbridge_msgs/action/MoveitGoal",
    )


async def keep_parameters(agent: Agent) -> None:
    """Set, read and delete a parameter of a client."""
    call = agent.call
    await call("parameter before", "has_parameter", name="/agent:speed")
    await call("unknown parameter", "get_parameter", name="/agent:speed")
    await call("parameter set", "set_parameter", name="/agent:speed", value="0.5")
    await call("parameter", "get_parameter", name="/agent:speed")
    await call("parameter there", "has_parameter", name="/agent:speed")
    await call("parameter details", "get_parameter_details", name="/agent:speed")
    await call("parameters", "get_parameters", node_name="/agent")
    await call("parameter deleted", "delete_parameter", name="/agent:speed")
    await call("parameter after", "has_parameter", name="/agent:speed")


async def listen(agent: Agent) -> None:
    """Subscribe, also to pictures."""
    call = agent.call
    await call("joint states", "subscribe_once", topic="/joint_states", msg_type="sensor_msgs/msg/JointState")
    await call("wrong type", "subscribe_once", topic="/joint_states", msg_type="std_msgs/msg/String", timeout=1.0)
    many = {"topic": "/joint_states", "msg_type": "sensor_msgs/msg/JointState", "max_messages": 5, "duration": 5.0}
    await call("many joint states", "subscribe_for_duration", **many, expects_image="false")
    for name, type_name in (("compressed", "CompressedImage"), ("image", "Image")):
        topic, full_type = f"/camera/{name}", f"sensor_msgs/msg/{type_name}"
        await call(f"picture {name}", "subscribe_once", topic=topic, msg_type=full_type, expects_image="true")
    await call("saved picture", "view_saved_image")


async def move(agent: Agent, port: int) -> None:
    """Publish, call services and send goals: what moves the arm."""
    call = agent.call
    event, results = first_message(port, "/moveit_goal_result", "moveit_msgs/msg/MoveItErrorCodes")
    goal = {"topic": "/moveit_goal_joints", "msg_type": "sensor_msgs/msg/JointState"}
    await call("goal published", "publish_once", **goal, msg=TURNED)
    await asyncio.to_thread(event.wait, 20.0)
    agent.answers["goal reached"] = results
    event, heard = first_message(port, "/chatter", "std_msgs/msg/String")
    await asyncio.sleep(0.2)
    text = {"topic": "/chatter", "msg_type": "std_msgs/msg/String", "messages": [{"data": "hello"}]}
    await call("published at a rate", "publish_for_durations", **text, durations=[0.3], rate_hz=20)
    await asyncio.to_thread(event.wait, 5.0)
    agent.answers["heard"] = heard
    point = {"header": {"frame_id": "base_link"}, "pose": {"position": {"x": 2.0}, "orientation": {"w": 1.0}}}
    goals = {"poses": [point], "joints": [TURNED]}
    await call("goals checked", "call_service", service_name="/check_goals", service_type="", request=goals)
    trigger = "std_srvs/srv/Trigger"
    await call("unknown service called", "call_service", service_name="/nothing", service_type=trigger, request={})
    gripper = {"action_name": GRIPPER[0], "action_type": GRIPPER[1]}
    wide = {"command": {"position": 1.0, "max_effort": 0.0}}
    await call("gripped", "send_action_goal", **gripper, goal=wide, timeout=20.0)
    await call("wrong goal", "send_action_goal", **gripper, goal={"command": {"position": "wide"}})
    goal_call = {"service_name": "/moveit_goal", "service_type": "armbridge_msgs/srv/MoveitGoal", "timeout": 20.0}
    await call("planned", "call_service", **goal_call, request={"named": "ready", "plan_only": True})
    await call("moved", "call_service", **goal_call, request={"named": "ready"})
    await call("called wrongly", "call_service", **goal_call, request={"named": "raedy"})
    await call("called out of reach", "call_service", **goal_call, request={"pose": point})
    goal_action = {"action_name": "/moveit_goal", "action_type": "armbridge_msgs/action/MoveitGoal"}
    await call("sent", "send_action_goal", **goal_action, goal={"named": "home"}, timeout=20.0)
    slowly = {"joints": {"name": ["shoulder_pan"], "position": [-0.8]}, "velocity_scaling": 0.05}
    started = await call("goal in progress", "send_action_goal", **goal_action, goal=slowly, timeout=1.0)
    await call("active action", "get_action_status", action_name="/moveit_goal")
    await call("cancelled", "cancel_action_goal", action_name="/moveit_goal", goal_id=started["goal_id"])
    await asyncio.sleep(1.0)
    await call("cancelled action", "get_action_status", action_name="/moveit_goal")
    await call("stopped", "call_service", service_name="/arm/stop", service_type=trigger, request={})


async def main(port: int, folder: Path) -> dict[str, Any]:
    """Call every tool."""
    command = StdioServerParameters(command=str(Path(sys.executable).with_name("ros-mcp")), cwd=str(folder))
    pictures = camera(port)
    with (folder / "ros_mcp.log").open("w") as log:
        async with stdio_client(command, errlog=log) as streams, ClientSession(*streams) as session:
            await session.initialize()
            agent = Agent(session)
            agent.answers["tools"] = [tool.name for tool in (await session.list_tools()).tools]
            await look(agent, port)
            await keep_parameters(agent)
            await listen(agent)
            await move(agent, port)
            for resource in (await session.list_resources()).resources:
                (content,) = (await session.read_resource(resource.uri)).contents
                agent.answers[str(resource.uri)] = json.loads(content.text)
    pictures.close()
    agent.answers["called"] = sorted(agent.called)
    return agent.answers


if __name__ == "__main__":
    print(json.dumps(asyncio.run(main(int(sys.argv[1]), Path(sys.argv[2])))))
