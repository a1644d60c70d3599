"""A server with a simulated arm that the test commands, and a client that calls services and sends goals."""

from __future__ import annotations

import asyncio
import itertools
import json
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from tests.helpers.emulator_control import EmulatorControl
from tests.helpers.server import RunningServer

ANSWER_TIMEOUT_S = 10.0

LATCHED = {
    "/arm/state": "diagnostic_msgs/DiagnosticStatus",
    "/arm/joint_limits": "moveit_msgs/KinematicSolverInfo",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/joint_states": "sensor_msgs/JointState",
    "/moveit_goal_result": "moveit_msgs/MoveItErrorCodes",
}


@dataclass
class ServerOnBus:
    """A running server and the emulated servos of its arm."""

    server: RunningServer
    emulator: EmulatorControl


@contextmanager
def server_on_bus(arguments: str = "--port 0", **settings: str) -> Iterator[ServerOnBus]:
    """Start a server; settings are environment variables without ``ARMBRIDGE_``."""
    # A short path: that of a Unix socket has 107 bytes at most, and pytest's folders are deep.
    with tempfile.TemporaryDirectory(prefix="arm") as folder:
        control = Path(folder) / "control"
        settings = {"EMULATOR__CONTROL": str(control), **settings}
        with RunningServer(arguments, {f"ARMBRIDGE_{key}": value for key, value in settings.items()}) as server:
            yield ServerOnBus(server, EmulatorControl(control))


class ArmClient:
    """A rosbridge client that knows which answer belongs to which request."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.websocket = websocket
        self.topics: dict[str, list[dict[str, Any]]] = {}
        self.feedback: dict[str, list[dict[str, Any]]] = {}
        self._answers: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self._ids = map(str, itertools.count(1))
        self._news = asyncio.Condition()
        self.reader = asyncio.create_task(self._read())

    async def say(self, op: str, **fields: Any) -> None:
        await self.websocket.send(json.dumps({"op": op, **fields}))

    async def call(self, service: str, **request: Any) -> dict[str, Any]:
        """Call a service; returns its response."""
        answer = self._expect(request_id := next(self._ids))
        await self.say("call_service", service=service, id=request_id, args=request)
        values: dict[str, Any] = (await asyncio.wait_for(answer, ANSWER_TIMEOUT_S))["values"]
        return values

    async def send_goal(self, action: str, type_name: str, args: dict[str, Any]) -> str:
        """Send an action goal; returns its id."""
        self._expect(goal_id := next(self._ids))
        await self.say("send_action_goal", action=action, action_type=type_name, id=goal_id, args=args, feedback=True)
        return goal_id

    async def result(self, goal_id: str) -> dict[str, Any]:
        """The ``action_result`` of a goal."""
        return await asyncio.wait_for(self._answers[goal_id], ANSWER_TIMEOUT_S)

    async def goal(self, topic: str, type_name: str, msg: dict[str, Any]) -> None:
        await self.say("advertise", topic=topic, type=type_name)
        await self.say("publish", topic=topic, msg=msg)

    async def until(
        self, topic: str, condition: Callable[[list[dict[str, Any]]], bool], timeout_s: float = ANSWER_TIMEOUT_S
    ) -> list[dict[str, Any]]:
        """The messages of a topic, once they fulfil a condition."""
        async with asyncio.timeout(timeout_s), self._news:
            await self._news.wait_for(lambda: bool(self.topics.get(topic)) and condition(self.topics[topic]))
        return self.topics[topic]

    async def until_mode(self, mode: str) -> dict[str, Any]:
        """The state, once the arm is in a mode."""
        return (await self.until("/arm/state", lambda states: values_of(states[-1])["mode"] == mode))[-1]

    def _expect(self, request_id: str) -> asyncio.Future[dict[str, Any]]:
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[request_id] = answer
        return answer

    async def _read(self) -> None:
        async for frame in self.websocket:
            operation = json.loads(frame)
            async with self._news:
                if operation["op"] == "publish":
                    self.topics.setdefault(operation["topic"], []).append(operation["msg"])
                elif operation["op"] == "action_feedback":
                    self.feedback.setdefault(operation["id"], []).append(operation["values"])
                elif operation.get("id") in self._answers and not self._answers[operation["id"]].done():
                    self._answers[operation["id"]].set_result(operation)
                self._news.notify_all()


def values_of(status: dict[str, Any]) -> dict[str, str]:
    """The values of a diagnostic_msgs/DiagnosticStatus."""
    return {pair["key"]: pair["value"] for pair in status["values"]}


@asynccontextmanager
async def arm_client(url: str) -> AsyncIterator[ArmClient]:
    """A client that has subscribed to all that is told of the arm."""
    websocket = await connect(url, max_size=None)
    client = ArmClient(websocket)
    for topic, type_name in LATCHED.items():
        await client.say("subscribe", topic=topic, type=type_name)
    try:
        yield client
    finally:
        await websocket.close()
        await asyncio.gather(client.reader, return_exceptions=True)
