from __future__ import annotations

import asyncio
from typing import Any

import pytest

from protocol.errors import MessageError
from protocol.registry import Registry
from server.calls import Call, Response, answer
from server.errors import ServiceError
from server.interfaces import Interfaces
from server.node import Node

INTERFACES = Interfaces(Registry.load())


@pytest.fixture
def call() -> Call:
    return Call("/switch", "std_srvs/srv/SetBool", {"data": True}, INTERFACES, Node("caller"))


@pytest.fixture
def responses(call: Call) -> list[Response]:
    heard: list[Response] = []
    call.when_ended(heard.append)
    return heard


def test_a_response_is_completed(call: Call, responses: list[Response]) -> None:
    call.succeed({})
    assert responses == [Response(ok=True, values={"success": False, "message": ""})]


def test_a_response_that_is_complete_is_told_as_it_is(call: Call, responses: list[Response]) -> None:
    complete = {"success": True, "message": "done"}
    call.succeed_as_it_is(complete)
    assert responses[0].ok
    assert responses[0].values is complete


def test_a_response_that_does_not_fit_is_a_failure_to_the_caller_and_an_error_to_the_provider(
    call: Call, responses: list[Response]
) -> None:
    with pytest.raises(MessageError):
        call.succeed("done")
    assert not responses[0].ok
    assert "does not fit std_srvs/srv/SetBool" in responses[0].values


def test_a_failure_carries_what_the_provider_gave(call: Call, responses: list[Response]) -> None:
    call.fail({"reason": 7})
    assert responses == [Response(ok=False, values={"reason": 7})]


def test_a_function_gets_the_request(call: Call, responses: list[Response]) -> None:
    answer(call, lambda request: {"success": request["data"]})
    assert responses[0].values["success"] is True


async def test_an_awaited_service_error_is_a_failure(call: Call, responses: list[Response]) -> None:
    async def switch(_request: dict[str, Any]) -> dict[str, Any]:
        await asyncio.sleep(0)
        raise ServiceError("no power")

    answer(call, switch)
    for _ in range(3):
        await asyncio.sleep(0)
    assert responses == [Response(ok=False, values="no power")]
