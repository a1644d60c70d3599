from __future__ import annotations

import logging

import bson
import pytest

from protocol.operations import Auth
from protocol.session import Refusal
from server.gateway.client_context import MAX_UNASKED_ERRORS
from server.graph.node import Node
from tests.helpers.gateway import InProcess

NO_JSON = Refusal(None, None, "no JSON")


@pytest.fixture
def world() -> InProcess:
    return InProcess()


@pytest.mark.parametrize(("level", "logged"), [("error", "ERROR"), ("warning", "WARNING"), ("info", "INFO")])
def test_a_status_from_a_client_is_logged_at_its_level_and_shortened(
    world: InProcess, caplog: pytest.LogCaptureFixture, level: str, logged: str
) -> None:
    with caplog.at_level(logging.DEBUG):
        world.say("x", op="status", level=level, msg="y" * 10_000)
    (record,) = caplog.records
    assert record.levelname == logged
    assert record.getMessage().startswith("x says: yyy")
    assert len(record.getMessage()) < 200


def test_no_client_writes_lines_of_its_own_into_the_log(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    world.say("x", op="set_level", level="error")
    world.client("x").status.refuse(Refusal("publish", None, "publish: topic /a\nERROR all is lost\x1b[2J: no"))
    world.say("x", op="status", level="error", msg="a\r\nb")
    assert [len(record.getMessage().splitlines()) for record in caplog.records] == [1, 1]
    assert world.heard("x")[0]["msg"] == r"publish: topic /a\nERROR all is lost\x1b[2J: no"


def test_a_token_is_not_yet_a_valid_operation(world: InProcess) -> None:
    status = world.client("x").status
    status.acknowledge(Auth(token="t" * 16))
    status.refuse(NO_JSON)
    assert len(world.heard("x")) == 1


def test_a_client_that_never_sends_anything_valid_gets_some_errors_only(world: InProcess) -> None:
    for _ in range(2 * MAX_UNASKED_ERRORS):
        world.client("x").status.refuse(NO_JSON)
    assert len(world.heard("x")) == MAX_UNASKED_ERRORS


async def test_replies_to_a_client_that_speaks_bson_have_octets(world: InProcess) -> None:
    world.graph.services.offer(Node("s"), "/fetch", "file_server/GetBinaryFile", lambda _: {"value": "AQI="})
    await world.send("x", bson.encode({"op": "call_service", "service": "/fetch"}))
    frame = await world.next_frame("x")
    assert isinstance(frame, bytes)
    assert bson.decode(frame)["values"]["value"] == b"\x01\x02"
