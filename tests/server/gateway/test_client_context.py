from __future__ import annotations

import json
import logging
from typing import Any

import bson
import pytest

from protocol.operations import Auth, Operation, SetLevel, Status
from protocol.session import Refusal, Session
from server.gateway.client_context import MAX_UNASKED_ERRORS, ClientStatus, MessageTranslator
from server.graph.node import Node
from tests.helpers.gateway import REGISTRY


class Told:
    """A client that has asked for all levels, and what it is told."""

    def __init__(self, level: str = "info") -> None:
        self.session = Session()
        self.woken = 0
        self.status = ClientStatus(Node("x", remote=True), self.session, lambda: 0.0, self._wake)
        self.carry_out(SetLevel(level=level))

    def _wake(self) -> None:
        self.woken += 1

    def carry_out(self, operation: Operation) -> None:
        if isinstance(operation, SetLevel):
            self.status.set_level(operation)
        elif isinstance(operation, Status):
            self.status.log_status(operation)

    def messages(self) -> list[dict[str, Any]]:
        return [json.loads(frame.data) for each in self.session.data_to_send(0.0) for frame in each.frames]


@pytest.mark.parametrize(("level", "logged"), [("error", "ERROR"), ("warning", "WARNING"), ("info", "INFO")])
def test_a_status_from_a_client_is_logged_at_its_level_and_shortened(
    caplog: pytest.LogCaptureFixture, level: str, logged: str
) -> None:
    with caplog.at_level(logging.DEBUG):
        Told().carry_out(Status(level=level, msg="y" * 10_000))  # type: ignore[arg-type]
    (record,) = caplog.records
    assert record.levelname == logged
    assert record.getMessage().startswith("x says: yyy")
    assert len(record.getMessage()) < 200


def test_no_client_writes_lines_of_its_own_into_the_log(caplog: pytest.LogCaptureFixture) -> None:
    told = Told("error")
    told.status.refuse(Refusal("publish", None, "publish: topic /a\nERROR all is lost\x1b[2J: no"))
    told.carry_out(Status(level="error", msg="a\r\nb"))
    assert [len(record.getMessage().splitlines()) for record in caplog.records] == [1, 1]
    assert told.messages()[0]["msg"] == r"publish: topic /a\nERROR all is lost\x1b[2J: no"


def raw_client() -> Told:
    """Return a client that has asked for no status messages."""
    told = Told()
    told.session = Session()
    told.status = ClientStatus(Node("x", remote=True), told.session, lambda: 0.0, lambda: None)
    return told


def test_a_token_is_not_yet_a_valid_operation() -> None:
    told = raw_client()
    told.status.acknowledge(Auth(token="t" * 16))
    told.status.refuse(Refusal(None, None, "no JSON"))
    assert len(told.messages()) == 1


def test_a_client_that_never_sends_anything_valid_gets_some_errors_only() -> None:
    told = raw_client()
    for _ in range(2 * MAX_UNASKED_ERRORS):
        told.status.refuse(Refusal(None, None, "no JSON"))
    assert len(told.messages()) == MAX_UNASKED_ERRORS


def test_replies_to_a_client_that_speaks_bson_have_octets() -> None:
    session = Session()
    translator = MessageTranslator(session, REGISTRY)
    image = {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": ""}, "format": "png", "data": "AQI="}
    assert translator.to_client("sensor_msgs/msg/CompressedImage", image) is image
    session.receive_frame(bson.encode({"op": "set_level", "level": "none"}), 0.0)
    assert translator.to_client("sensor_msgs/msg/CompressedImage", image)["data"] == b"\x01\x02"
