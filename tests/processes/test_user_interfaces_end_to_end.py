"""Types of a user's own packages in a running server: from the option to the wire, the recording and the replay."""

import asyncio
import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cbor2
import pytest
from mcap.reader import make_reader
from websockets.asyncio.client import ClientConnection, connect

from harness.server import RunningServer
from harness.waiting import TIMEOUT_S
from protocol.codecs import cdr
from protocol.interface_packages import read_packages
from tests.conformance.cases import INTERFACES

REGISTRY = read_packages([INTERFACES]).registry()
SAMPLE = {
    "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "bench"},
    "name": "left",
    "label": "Fühler 😀",
    "offset": [1.0, 2.0, 3.0],
    "counts": [7],
    "tags": ["x"],
    "raw": "AAEC",
    "ready": False,
    "tag": {"text": "a", "level": 1, "since": {"sec": 1, "nanosec": 0}},
    "others": [],
}


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    folders = f"--interfaces {INTERFACES / 'lab_msgs'} --interfaces {INTERFACES / 'robots'}"
    with RunningServer(f"--port 0 {folders}") as running:
        yield running


async def say(websocket: ClientConnection, **operation: Any) -> None:
    await websocket.send(json.dumps(operation))


async def hear(websocket: ClientConnection, op: str) -> dict[str, Any]:
    """Return the next operation of a kind."""
    while True:
        frame = await asyncio.wait_for(websocket.recv(), TIMEOUT_S)
        operation: dict[str, Any] = json.loads(frame) if isinstance(frame, str) else cbor2.loads(frame)
        if operation["op"] == op:
            return operation


async def offer(websocket: ClientConnection, **operation: Any) -> None:
    """Send an operation that others depend on, and wait until it has been carried out."""
    await say(websocket, op="set_level", level="info")
    await say(websocket, **operation)
    await hear(websocket, "status")


async def test_a_message_of_the_users_type_is_relayed_as_json_and_as_cdr(server: RunningServer) -> None:
    async with connect(server.url) as talker, connect(server.url) as listener, connect(server.url) as reader:
        await offer(talker, op="advertise", topic="/sample", type="lab_msgs/Sample", latch=True)
        await say(talker, op="publish", topic="/sample", msg=SAMPLE)
        await say(listener, op="subscribe", topic="/sample", type="lab_msgs/msg/Sample")
        await say(reader, op="subscribe", topic="/sample", compression="cbor-raw")
        assert (await hear(listener, "publish"))["msg"] == SAMPLE
        octets = (await hear(reader, "publish"))["msg"]["bytes"]
        assert cdr.deserialize(REGISTRY, "lab_msgs/Sample", octets) == SAMPLE


async def test_a_recording_has_the_definitions_of_the_users_types(tmp_path: Path) -> None:
    with RunningServer(f"--port 0 --interfaces {INTERFACES} --record {tmp_path / 'run.mcap'}") as server:
        async with connect(server.url) as talker, connect(server.url) as listener:
            await say(listener, op="subscribe", topic="/sample", type="lab_msgs/msg/Sample")
            await say(talker, op="advertise", topic="/sample", type="lab_msgs/Sample")
            await say(talker, op="publish", topic="/sample", msg=SAMPLE)
            await hear(listener, "publish")
        server.end(signal.SIGTERM)
    with (tmp_path / "run.mcap").open("rb") as stream:
        ((schema, _, message),) = make_reader(stream).iter_messages("/sample")
    assert schema is not None
    assert b"string<=8 name" in schema.data
    assert cdr.deserialize(REGISTRY, schema.name, message.data) == SAMPLE
