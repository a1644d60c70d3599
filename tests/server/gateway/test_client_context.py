from __future__ import annotations

import json
import logging
from typing import Any

import pytest

from protocol.errors import MessageError, NothingToDoError, OperationError
from protocol.operations import Advertise, Auth, Operation, Publish, SetLevel, Status, Subscribe, Unsubscribe
from protocol.session import Refusal, Session
from server.errors import GraphError
from server.gateway.client_context import MAX_UNASKED_ERRORS, ClientStatus
from server.graph.node import Node


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


def test_a_refusal_is_an_error_and_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    told = Told("error")
    told.status.refuse(Refusal("publish", "p1", "publish: no"))
    assert told.messages() == [{"op": "status", "level": "error", "msg": "publish: no", "id": "p1"}]
    assert told.woken == 1
    assert "x: refused: publish: no" in caplog.text


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (MessageError("string", "1", "data"), "publish: field data: wanted string, got 1"),
        (OperationError("publish", "msg", "no"), "publish: field msg: no"),
    ],
)
def test_an_error_names_its_operation_once(error: Any, text: str) -> None:
    told = Told("error")
    told.status.refuse_error("publish", error)
    assert told.messages() == [{"op": "status", "level": "error", "msg": text}]


def test_withdrawing_nothing_is_a_warning_and_not_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    told = Told("warning")
    told.status.refuse_error("unsubscribe", NothingToDoError("unsubscribe", None, "topic /a"), 7)
    assert told.messages() == [{"op": "status", "level": "warning", "msg": "unsubscribe: topic /a", "id": 7}]
    assert caplog.text == ""


@pytest.mark.parametrize(
    ("operation", "levels"),
    [
        (Advertise(topic="/a", type="std_msgs/String"), ["info"]),
        (Unsubscribe(topic="/a"), ["info"]),
        (Subscribe(topic="/a", qos={"depth": 1}), ["info", "warning"]),
        (Subscribe(topic="/a", qos={}), ["info"]),
        (Publish(topic="/a"), []),
        (Status(msg="hello"), []),
    ],
)
def test_operations_without_a_response_are_acknowledged_but_for_messages(
    operation: Operation, levels: list[str]
) -> None:
    told = Told()
    told.status.acknowledge(operation)
    assert [message["level"] for message in told.messages()] == levels


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


def test_a_client_that_has_sent_nothing_valid_gets_errors_unasked() -> None:
    told = raw_client()
    told.status.refuse(Refusal(None, None, "no JSON"))
    told.status.refuse_error("publish", GraphError("topic", "/a", "has no type yet"), 1)
    assert [message["msg"] for message in told.messages()] == ["no JSON", "publish: topic /a: has no type yet"]


def test_errors_in_an_operation_that_the_client_knows_are_not_told_unasked() -> None:
    told = raw_client()
    told.status.refuse(Refusal("publish", None, "publish: field msg: no"))
    told.status.reject(Publish(topic="/a", id=1), "it needs the role operate")
    assert told.messages() == []


@pytest.mark.parametrize("operation", [Publish(topic="/a"), SetLevel(level="none")])
def test_after_its_first_valid_operation_it_gets_what_it_asks_for(operation: Operation) -> None:
    told = raw_client()
    told.carry_out(operation)
    told.status.acknowledge(operation)
    told.status.refuse(Refusal(None, None, "no JSON"))
    told.status.doubt(Subscribe(topic="/a"), "nobody else uses it")
    assert told.messages() == []


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


def test_what_fails_behind_a_valid_operation_is_not_told_unasked() -> None:
    told = raw_client()
    told.status.tell("error", Publish(topic="/a"), "in collision")
    assert told.messages() == []
