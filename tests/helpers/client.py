"""A rosbridge client that only knows frames: what it sends is on the wire to the letter."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

GOAL_TYPES = {
    "/moveit_goal_named": "std_msgs/String",
    "/moveit_goal_joints": "sensor_msgs/JointState",
    "/moveit_goal_pose": "geometry_msgs/PoseStamped",
}


class FrameClient:
    """Sends frames, keeps what comes back by topic."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.websocket = websocket
        self.received: dict[str, list[dict[str, Any]]] = {}
        self._news = asyncio.Condition()
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

    async def goal(self, topic: str, msg: dict[str, Any], timeout_s: float = 60.0) -> dict[str, Any]:
        """Publish a goal and wait for the next result."""
        seen = len(self.messages("/moveit_goal_result"))
        await self.publish(topic, msg)
        return (await self.wait_for("/moveit_goal_result", lambda all_: len(all_) > seen, timeout_s))[seen]

    def messages(self, topic: str) -> list[dict[str, Any]]:
        return self.received.get(topic, [])

    async def wait_for(
        self, topic: str, condition: Callable[[list[dict[str, Any]]], bool], timeout_s: float = 60.0
    ) -> list[dict[str, Any]]:
        async with asyncio.timeout(timeout_s), self._news:
            await self._news.wait_for(lambda: condition(self.messages(topic)))
        return self.messages(topic)

    async def _read(self) -> None:
        async for frame in self.websocket:
            operation = json.loads(frame)
            operation["msg"]["_at_s"] = time.monotonic()
            async with self._news:
                self.received.setdefault(operation["topic"], []).append(operation["msg"])
                self._news.notify_all()

    async def close(self) -> None:
        await self.websocket.close()
        await asyncio.gather(self._reader, return_exceptions=True)


@asynccontextmanager
async def frame_client(url: str) -> AsyncIterator[FrameClient]:
    websocket = await connect(url, max_size=None)
    client = FrameClient(websocket)
    try:
        yield client
    finally:
        await client.close()


def status_state(status: dict[str, Any]) -> str:
    """``state`` of a goal's status."""
    return str(next(pair["value"] for pair in status["values"] if pair["key"] == "state"))


def goal_is(state: str) -> Callable[[list[dict[str, Any]]], bool]:
    """Condition on the messages of /moveit_goal_status: the latest tells this state."""
    return lambda messages: bool(messages) and status_state(messages[-1]) == state
