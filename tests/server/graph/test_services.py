from __future__ import annotations

import asyncio
from typing import Any

import pytest

from protocol.registry import Registry
from server.errors import GraphError, ServiceError
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.services import (
    LOCAL_TIMEOUT_S,
    MAX_TIMEOUT_S,
    Call,
    Response,
    Services,
    answer,
)
from tests.helpers.clock import FakeClock

INTERFACES = MessageTypes(Registry.load())


@pytest.fixture
def call() -> Call:
    return Call("/switch", "std_srvs/srv/SetBool", {"data": True}, INTERFACES, Node("caller"))


@pytest.fixture
def responses(call: Call) -> list[Response]:
    heard: list[Response] = []
    call.when_ended(heard.append)
    return heard


def test_a_response_that_is_complete_is_told_as_it_is(call: Call, responses: list[Response]) -> None:
    complete = {"success": True, "message": "done"}
    call.succeed_as_it_is(complete)
    assert responses[0].ok
    assert responses[0].values is complete


async def test_an_awaited_service_error_is_a_failure(call: Call, responses: list[Response]) -> None:
    async def switch(_request: dict[str, Any]) -> dict[str, Any]:
        await asyncio.sleep(0)
        raise ServiceError("no power")

    answer(call, switch)
    for _ in range(3):
        await asyncio.sleep(0)
    assert responses == [Response(ok=False, values="no power")]


REGISTRY = Registry.load()

SERVER, CALLER = Node("server"), Node("caller", remote=True)
SET_BOOL = "std_srvs/SetBool"
ON = {"success": True, "message": "on"}


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def services(clock: FakeClock) -> Services:
    return Services(MessageTypes(REGISTRY), clock.call_later)


class Provider:
    """A client that offers a service and answers when the test says so."""

    def __init__(self, services: Services, name: str = "/switch") -> None:
        self.node = Node("provider", remote=True)
        self.calls: list[Call] = []
        services.offer_calls(self.node, name, SET_BOOL, self.calls.append)


def ask(services: Services, name: str = "/switch", caller: Node = CALLER, **options: Any) -> list[Response]:
    """Call a service; what comes back lands in the list."""
    responses: list[Response] = []
    services.call(caller, name, options.pop("arguments", {}), responses.append, **options)
    return responses


# Services of local parts


def test_a_function_answers_at_once_with_a_complete_request_and_response(services: Services) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda request: {"success": not request["data"]})
    assert ask(services) == [Response(ok=True, values={"success": True, "message": ""})]


async def test_an_async_function_answers_when_it_is_done(services: Services) -> None:
    go = asyncio.Event()

    async def switch(request: dict[str, Any]) -> dict[str, Any]:
        await go.wait()
        return ON

    services.offer(SERVER, "/switch", SET_BOOL, switch)
    responses = ask(services)
    await asyncio.sleep(0)
    assert responses == []
    go.set()
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert responses == [Response(ok=True, values=ON)]


@pytest.mark.parametrize("answer", [{"success": "yes"}, {"foo": 1}, "text"])
def test_a_function_with_a_bug_fails_the_call_and_is_logged(
    services: Services, answer: Any, caplog: pytest.LogCaptureFixture
) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: answer)
    ((response,)) = ask(services)
    assert not response.ok
    assert "/switch" in caplog.text


def test_a_function_that_raises_fails_the_call_and_is_logged(
    services: Services, caplog: pytest.LogCaptureFixture
) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: 1 / 0)  # type: ignore[arg-type,return-value]
    (response,) = ask(services)
    assert response == Response(ok=False, values="Service /switch failed inside the server")
    assert "ZeroDivisionError" in caplog.text


async def test_a_function_that_takes_too_long_is_cancelled(services: Services, clock: FakeClock) -> None:
    cancelled = asyncio.Event()

    async def switch(_request: dict[str, Any]) -> dict[str, Any]:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            cancelled.set()
            raise
        return ON

    services.offer(SERVER, "/switch", SET_BOOL, switch)
    responses = ask(services)
    await asyncio.sleep(0)
    clock.advance(LOCAL_TIMEOUT_S)
    assert not responses[0].ok
    await asyncio.wait_for(cancelled.wait(), 1.0)


# Services of clients


@pytest.mark.parametrize(
    ("timeout_s", "bound_s"),
    [(None, LOCAL_TIMEOUT_S), (0.5, 0.5), (0.0, MAX_TIMEOUT_S), (1e9, MAX_TIMEOUT_S)],
)
def test_every_call_ends_in_time(services: Services, clock: FakeClock, timeout_s: float | None, bound_s: float) -> None:
    Provider(services)
    responses = ask(services, timeout_s=timeout_s)
    clock.advance(bound_s * 0.99)
    assert responses == []
    clock.advance(bound_s * 0.02)
    assert not responses[0].ok
    assert f"did not answer in {bound_s:g} s" in responses[0].values


def test_a_call_that_has_ended_leaves_nothing_behind(services: Services, clock: FakeClock) -> None:
    provider = Provider(services)
    ask(services)
    provider.calls[0].succeed(ON)
    assert clock.waiting == 0
    assert not services._offers.get("/switch").calls


def test_the_calls_of_a_caller_that_leaves_end_for_their_provider(services: Services, clock: FakeClock) -> None:
    provider = Provider(services)
    ask(services)
    services.remove(CALLER)
    assert provider.calls[0].ended
    assert clock.waiting == 0


# Names


def test_the_number_of_services_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.graph.services.MAX_SERVICES", 5)
    services = Services(MessageTypes(REGISTRY), FakeClock().call_later)
    for number in range(5):
        services.offer(SERVER, f"/s{number}", SET_BOOL, lambda _: ON)
    with pytest.raises(GraphError, match="there are 5 services"):
        services.offer(SERVER, "/one_more", SET_BOOL, lambda _: ON)


def test_a_call_says_what_dialect_its_caller_wants_to_be_told_in(services: Services) -> None:
    provider = Provider(services)
    ask(services)
    ask(services, dialect="ros1")
    assert [call.dialect for call in provider.calls] == ["ros2", "ros1"]


def test_what_a_node_provides_and_who_provides_a_type_can_be_looked_up(services: Services) -> None:
    node, other = Node("node", remote=True), Node("other", remote=True)
    for provider, name in ((node, "/a"), (node, "/b"), (other, "/c")):
        services.offer_calls(provider, name, "std_srvs/SetBool", lambda _call: None)
    assert services.provided_by(node) == ["/a", "/b"]
    assert services.providers_of_type("std_srvs/srv/SetBool") == {node, other}
    assert services.providers_of_type("std_srvs/Trigger") == set()
    services.remove(node)
    assert services.provided_by(node) == []
    assert services.nodes() == [other]
