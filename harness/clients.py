"""Rosbridge clients of a running server, with and without an event loop."""

import asyncio
import itertools
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.sync import client as blocking

from harness.waiting import TIMEOUT_S

GOAL_TYPES = {
    "/moveit_goal_named": "std_msgs/String",
    "/moveit_goal_joints": "sensor_msgs/JointState",
    "/moveit_goal_pose": "geometry_msgs/PoseStamped",
}

# Topic and type of the pace of all motions, also of the present one.
SPEED_FACTOR = ("/arm/speed_factor", "std_msgs/Float64")

LATCHED = {
    "/arm/state": "diagnostic_msgs/DiagnosticStatus",
    "/arm/joint_limits": "moveit_msgs/KinematicSolverInfo",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/joint_states": "sensor_msgs/JointState",
    "/moveit_goal_result": "moveit_msgs/MoveItErrorCodes",
}


Condition = Callable[[list[dict[str, Any]]], object]


@dataclass
class Wait:
    """A wait for messages of a topic."""

    topic: str
    condition: Condition
    ended: asyncio.Future[list[dict[str, Any]]]

    def look(self, messages: list[dict[str, Any]]) -> None:
        """End the wait if the messages fulfil its condition."""
        try:
            if messages and not self.ended.done() and self.condition(messages):
                self.ended.set_result(messages[:])
        except Exception as error:  # noqa: BLE001 - it is the waiting test's
            self.ended.set_exception(error)


class FrameClient:
    """Sends frames, keeps what comes back by topic."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.websocket = websocket
        self.topics: dict[str, list[dict[str, Any]]] = {}
        self._waits: list[Wait] = []
        self._reader = asyncio.create_task(self._read())

    async def send(self, frame: str | dict[str, Any]) -> None:
        await self.websocket.send(frame if isinstance(frame, str) else json.dumps(frame))

    async def subscribe(self, topic: str, type_name: str) -> None:
        await self.send({"op": "subscribe", "topic": topic, "type": type_name})

    async def open_goals(self) -> None:
        """Subscribe to the answers and advertise the goal topics."""
        await self.subscribe("/moveit_goal_result", "moveit_msgs/MoveItErrorCodes")
        await self.subscribe("/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus")
        for topic, type_name in GOAL_TYPES.items():
            await self.send({"op": "advertise", "topic": topic, "type": type_name})

    async def publish(self, topic: str, msg: dict[str, Any]) -> None:
        await self.send({"op": "publish", "topic": topic, "msg": msg})

    async def set_speed(self, factor: float) -> None:
        """Set the speed factor of motions: on a busy machine a slow motion lasts until a test has looked at it."""
        topic, type_name = SPEED_FACTOR
        await self.send({"op": "publish", "topic": topic, "type": type_name, "msg": {"data": factor}})

    async def reach(self, topic: str, msg: dict[str, Any], timeout_s: float = TIMEOUT_S) -> dict[str, Any]:
        """Publish a goal and wait for the next result."""
        seen = len(self.messages("/moveit_goal_result"))
        await self.publish(topic, msg)
        return (await self.until("/moveit_goal_result", lambda all_: len(all_) > seen, timeout_s))[seen]

    def messages(self, topic: str) -> list[dict[str, Any]]:
        return self.topics.get(topic, [])

    async def until(self, topic: str, condition: Condition, timeout_s: float = TIMEOUT_S) -> list[dict[str, Any]]:
        """The messages of a topic, as they first were when there were some that fulfil a condition.

        It is asked at each message: of those that come together no state is missed.
        """
        wait = Wait(topic, condition, asyncio.get_running_loop().create_future())
        wait.look(self.messages(topic))
        self._waits.append(wait)
        try:
            return await asyncio.wait_for(wait.ended, timeout_s)
        finally:
            self._waits.remove(wait)

    async def positions(self) -> dict[str, float]:
        """Return the position of every joint [rad or m], by a state that comes from now on."""
        seen = len(self.messages("/joint_states"))
        state = (await self.until("/joint_states", lambda all_: len(all_) > seen + 1))[-1]
        return dict(zip(state["name"], state["position"], strict=True))

    async def _read(self) -> None:
        async for frame in self.websocket:
            self._take(json.loads(frame))

    def _take(self, operation: dict[str, Any]) -> None:
        topic = operation["topic"]
        operation["msg"]["_at_s"] = time.monotonic()
        self.topics.setdefault(topic, []).append(operation["msg"])
        for wait in self._waits:
            if wait.topic == topic:
                wait.look(self.topics[topic])

    async def close(self) -> None:
        await self.websocket.close()
        await asyncio.gather(self._reader, return_exceptions=True)


async def _connected(url: str) -> ClientConnection:
    # A server that is slow to answer a ping is no fault here.
    return await connect(url, max_size=None, ping_interval=None)


@asynccontextmanager
async def frame_client(url: str) -> AsyncIterator[FrameClient]:
    client = FrameClient(await _connected(url))
    try:
        yield client
    finally:
        await client.close()


def goal_is(state: str) -> Condition:
    """Condition on the messages of /moveit_goal_status: the latest has this state."""
    return lambda messages: values_of(messages[-1])["state"] == state


class ArmClient(FrameClient):
    """A client that knows which answer belongs to which request."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.feedback: dict[str, list[dict[str, Any]]] = {}
        self._answers: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self._ids = map(str, itertools.count(1))
        super().__init__(websocket)

    async def say(self, op: str, **fields: Any) -> None:
        await self.websocket.send(json.dumps({"op": op, **fields}))

    async def call(self, service: str, **request: Any) -> dict[str, Any]:
        """Call a service; returns its response."""
        answer = self._expect(request_id := next(self._ids))
        await self.say("call_service", service=service, id=request_id, args=request)
        values: dict[str, Any] = (await asyncio.wait_for(answer, TIMEOUT_S))["values"]
        return values

    async def send_goal(self, action: str, type_name: str, args: dict[str, Any]) -> str:
        """Send an action goal; returns its id."""
        self._expect(goal_id := next(self._ids))
        await self.say("send_action_goal", action=action, action_type=type_name, id=goal_id, args=args, feedback=True)
        return goal_id

    async def result(self, goal_id: str) -> dict[str, Any]:
        """The ``action_result`` of a goal."""
        return await asyncio.wait_for(self._answers[goal_id], TIMEOUT_S)

    async def goal(self, topic: str, type_name: str, msg: dict[str, Any]) -> None:
        await self.say("advertise", topic=topic, type=type_name)
        await self.say("publish", topic=topic, msg=msg)

    async def until_mode(self, mode: str) -> dict[str, Any]:
        """The state, once the arm is in a mode."""
        return (await self.until("/arm/state", lambda states: values_of(states[-1])["mode"] == mode))[-1]

    async def change_scene(self, *objects: dict[str, Any]) -> None:
        """Add or remove objects of the planning scene."""
        scene = {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": objects}}
        assert (await self.call("/apply_planning_scene", scene=scene))["success"]

    def _expect(self, request_id: str) -> asyncio.Future[dict[str, Any]]:
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[request_id] = answer
        return answer

    def _take(self, operation: dict[str, Any]) -> None:
        if operation["op"] == "publish":
            super()._take(operation)
        elif operation["op"] == "action_feedback":
            self.feedback.setdefault(operation["id"], []).append(operation["values"])
        elif operation.get("id") in self._answers and not self._answers[operation["id"]].done():
            self._answers[operation["id"]].set_result(operation)


def values_of(status: dict[str, Any]) -> dict[str, str]:
    """The values of a diagnostic_msgs/DiagnosticStatus."""
    return {pair["key"]: pair["value"] for pair in status["values"]}


@asynccontextmanager
async def arm_client(url: str) -> AsyncIterator[ArmClient]:
    """A client that has subscribed to all topics about the arm."""
    client = ArmClient(await _connected(url))
    for topic, type_name in LATCHED.items():
        await client.say("subscribe", topic=topic, type=type_name)
    try:
        yield client
    finally:
        await client.close()


def call(url: str, service: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
    """Call a service and wait for its values."""
    with blocking.connect(url) as websocket:
        return call_on(websocket, service, args)


def call_on(websocket: blocking.ClientConnection, service: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
    """As :func:`call`, on a connection that stays."""
    websocket.send(json.dumps({"op": "call_service", "service": service, "args": args or {}}))
    answer = json.loads(websocket.recv(timeout=TIMEOUT_S))
    assert answer["result"], answer
    values: dict[str, Any] = answer["values"]
    return values


def publish(url: str, topic: str, type_name: str, msg: dict[str, Any]) -> None:
    """Publish one message."""
    with blocking.connect(url) as websocket:
        websocket.send(json.dumps({"op": "publish", "topic": topic, "type": type_name, "msg": msg}))


def goal(url: str, topic: str, msg: dict[str, Any]) -> dict[str, Any]:
    """Send a goal and wait for its answer."""
    with blocking.connect(url) as websocket:
        websocket.send(
            json.dumps({"op": "subscribe", "topic": "/moveit_goal_result", "type": "moveit_msgs/MoveItErrorCodes"})
        )
        websocket.send(json.dumps({"op": "publish", "topic": topic, "msg": msg}))
        answer: dict[str, Any] = json.loads(websocket.recv(timeout=TIMEOUT_S))["msg"]
    return answer


def tip(url: str, link: str = "gripper_frame_link") -> tuple[float, float, float]:
    """Return the position of the tip of the arm, in the root link's frame [m]."""
    answer = call(url, "/compute_fk", {"fk_link_names": [link]})
    position = answer["pose_stamped"][0]["pose"]["position"]
    return float(position["x"]), float(position["y"]), float(position["z"])
