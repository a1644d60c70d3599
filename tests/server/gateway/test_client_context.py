from __future__ import annotations

import json
import logging
from typing import Any

import pytest

from protocol.errors import MessageError, NothingToDoError, OperationError
from protocol.operations import Advertise, Operation, Publish, SetLevel, Status, Subscribe, Unsubscribe
from protocol.session import Refusal, Session
from server.gateway.client_context import ClientStatus
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
