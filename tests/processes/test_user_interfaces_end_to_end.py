"""Types of a user's own packages in a running server: from the option to the wire, the recording and the replay."""

import asyncio
import json
import signal
from pathlib import Path
from typing import Any

import cbor2
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


async def say(websocket: ClientConnection, op: str, **fields: Any) -> None:
    await websocket.send(json.dumps({"op": op, "topic": "/sample", **fields}))


async def hear(websocket: ClientConnection, op: str) -> dict[str, Any]:
    """Return the next operation of a kind."""
    while True:
        frame = await asyncio.wait_for(websocket.recv(), TIMEOUT_S)
        operation: dict[str, Any] = json.loads(frame) if isinstance(frame, str) else cbor2.loads(frame)
        if operation["op"] == op:
            return operation


async def test_a_message_of_the_users_type_is_relayed_as_json_and_as_cdr_and_recorded(tmp_path: Path) -> None:
    folders = f"--interfaces {INTERFACES / 'lab_msgs'} --interfaces {INTERFACES / 'robots'}"
    with RunningServer(f"--port 0 {folders} --record {tmp_path / 'run.mcap'}") as server:
        async with connect(server.url) as talker, connect(server.url) as listener, connect(server.url) as reader:
            await say(talker, "set_level", level="info")
            await say(talker, "advertise", type="lab_msgs/Sample", latch=True)
            await hear(talker, "status")
            await say(talker, "publish", msg=SAMPLE)
            await say(listener, "subscribe", type="lab_msgs/msg/Sample")
            await say(reader, "subscribe", compression="cbor-raw")
            assert (await hear(listener, "publish"))["msg"] == SAMPLE
            octets = (await hear(reader, "publish"))["msg"]["bytes"]
            assert cdr.deserialize(REGISTRY, "lab_msgs/Sample", octets) == SAMPLE
        server.end(signal.SIGTERM)
    with (tmp_path / "run.mcap").open("rb") as stream:
        ((schema, _, message),) = make_reader(stream).iter_messages("/sample")
    assert schema is not None
    assert b"string<=8 name" in schema.data
    assert cdr.deserialize(REGISTRY, schema.name, message.data) == SAMPLE
