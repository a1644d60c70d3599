"""Types of a user's own packages in a running server: from the option to the wire, the recording and the replay."""

import asyncio
import json
import signal
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cbor2
import pytest
from mcap.reader import make_reader
from websockets.asyncio.client import ClientConnection, connect

from harness.clients import ANSWER_TIMEOUT_S, ArmClient
from harness.server import RunningServer
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


@asynccontextmanager
async def client(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with connect(server.url, max_size=None) as websocket:
        yield ArmClient(websocket)


async def say(websocket: ClientConnection, **operation: Any) -> None:
    await websocket.send(json.dumps(operation))


async def hear(websocket: ClientConnection, op: str) -> dict[str, Any]:
    """Return the next operation of a kind."""
    while True:
        frame = await asyncio.wait_for(websocket.recv(), ANSWER_TIMEOUT_S)
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


async def test_a_service_of_the_users_type_is_called(server: RunningServer) -> None:
    async with connect(server.url) as provider, connect(server.url) as caller:
        await offer(provider, op="advertise_service", service="/measure", type="lab_msgs/srv/Measure")
        await say(
            caller, op="call_service", service="/measure", args={"probe": "left"}, id="1", type="lab_msgs/Measure"
        )
        call = await hear(provider, "call_service")
        assert call["args"] == {"probe": "left", "known": []}
        values = {"success": True, "sample": SAMPLE}
        await say(provider, op="service_response", service="/measure", id=call["id"], values=values, result=True)
        assert (await hear(caller, "service_response"))["values"] == values


@pytest.mark.parametrize(
    ("type_name", "goal", "feedback", "result"),
    [
        ("lab_msgs/action/Scan", {"steps": 10}, {"progress": 0.5}, {"samples": [SAMPLE]}),
        ("example_interfaces/action/Fibonacci", {"order": 2}, {"sequence": [0, 1]}, {"sequence": [0, 1, 1]}),
        ("action_tutorials_interfaces/action/Fibonacci", {"order": 1}, {"partial_sequence": [0]}, {"sequence": [0, 1]}),
    ],
)
async def test_a_goal_of_an_action_has_feedback_and_result(
    server: RunningServer, type_name: str, goal: dict[str, Any], feedback: dict[str, Any], result: dict[str, Any]
) -> None:
    async with connect(server.url) as provider, connect(server.url) as caller:
        await offer(provider, op="advertise_action", action="/act", type=type_name, id="a")
        await say(caller, op="send_action_goal", action="/act", action_type=type_name, args=goal, feedback=True, id="g")
        asked = await hear(provider, "send_action_goal")
        assert asked["args"] == goal
        await say(provider, op="action_feedback", action="/act", id=asked["id"], values=feedback)
        assert (await hear(caller, "action_feedback"))["values"] == feedback
        await say(provider, op="action_result", action="/act", id=asked["id"], values=result, status=4, result=True)
        done = await hear(caller, "action_result")
        assert (done["values"], done["result"]) == (result, True)


async def test_rosapi_tells_fields_constants_and_defaults_of_the_users_types(server: RunningServer) -> None:
    async with client(server) as asking:
        sample, *others = (await asking.call("/rosapi/message_details", type="lab_msgs/Sample"))["typedefs"]
        assert dict(zip(sample["constnames"], sample["constvalues"], strict=True)) == {
            "OK": "0",
            "FAILED": "16",
            "UNIT": "mm # per turn",
            "LIMIT": "-1.5",
        }
        assert dict(zip(sample["fieldnames"], sample["examples"], strict=True))["name"] == "probe"
        assert "lab_msgs/Tag" in [each["type"] for each in others]
        request = (await asking.call("/rosapi/service_request_details", type="lab_msgs/Measure"))["typedefs"][0]
        assert request["fieldnames"] == ["probe", "known"]
        await asking.say("advertise", topic="/tag", type="lab_msgs/Tag")
        raw = await asking.call("/rosapi/topics_and_raw_types")
        text = raw["typedefs_full_text"][raw["topics"].index("/tag")]
        assert text.startswith('string<=10 text "none"\nint8 level -3\nbuiltin_interfaces/Time since\n')
        asking.reader.cancel()


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
