"""What compas_fab 2.0.1 said on the wire in a session of scene, kinematics and planning, frame by frame, said again."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from harness.server import RunningServer

STEPS = json.loads((Path(__file__).parent / "compas_fab_wire.json").read_text())
ANSWER_TIMEOUT_S = 60.0


async def the_answer(websocket: ClientConnection, step: dict[str, Any]) -> dict[str, Any]:
    """The next frame that answers a step; others, such as late messages of a topic, are passed over."""
    async with asyncio.timeout(ANSWER_TIMEOUT_S):
        async for frame in websocket:
            operation: dict[str, Any] = json.loads(frame)
            if operation.get("id") == step["send"]["id"] or operation.get("topic") == step.get("topic", "none"):
                return operation
    raise AssertionError("the server closed the connection")


def shown(values: dict[str, Any]) -> dict[str, Any]:
    """Return the outcome in a response, at any depth."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        if key == "error_code":
            found[key] = value["val"]
        elif key in ("success", "valid", "fraction"):
            found[key] = value
        elif isinstance(value, dict):
            found |= shown(value)
    return found


async def test_every_frame_is_answered_as_it_was(simulated_server: RunningServer) -> None:
    async with connect(simulated_server.url, max_size=None) as websocket:
        for step in STEPS:
            await websocket.send(json.dumps(step["send"]))
            if "topic" in step:
                assert (await the_answer(websocket, step))["msg"]["data"].startswith("<?xml")
            elif "answer" in step:
                answer = await the_answer(websocket, step)
                assert answer["result"] is True, step["send"]["service"]
                assert shown(answer["values"]) == pytest.approx(step["answer"]), step["send"]["id"]
