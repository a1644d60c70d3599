import asyncio
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S
from server.errors import GraphError, ServiceError
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.services import LOCAL_TIMEOUT_S, MAX_TIMEOUT_S, Call, Response, Services, answer
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY

INTERFACES = MessageTypes(REGISTRY)


@pytest.fixture
def call() -> Call:
    return Call("/switch", "std_srvs/srv/SetBool", {"data": True}, INTERFACES, Node("caller"))


@pytest.fixture
def responses(call: Call) -> list[Response]:
    heard: list[Response] = []
    call.when_ended(heard.append)
    return heard


async def test_an_awaited_service_error_is_a_failure(call: Call, responses: list[Response]) -> None:
    async def switch(_request: dict[str, Any]) -> dict[str, Any]:
        await asyncio.sleep(0)
        raise ServiceError("no power")

    answer(call, switch)
    for _ in range(3):
        await asyncio.sleep(0)
    assert responses == [Response(ok=False, values="no power")]


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


@pytest.mark.parametrize("answer", [{"success": "yes"}, {"foo": 1}, "text", None])
def test_a_bug_fails_the_call_and_is_logged(services: Services, answer: Any, caplog: pytest.LogCaptureFixture) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: answer or 1 / 0)
    (response,) = ask(services)
    assert not response.ok
    assert "/switch" in caplog.text
    if answer is None:
        assert response.values == "Service /switch failed inside the server"
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
    await asyncio.wait_for(cancelled.wait(), TIMEOUT_S)


# Services of clients


@pytest.mark.parametrize(
    ("timeout_s", "bound_s"), [(None, LOCAL_TIMEOUT_S), (0.5, 0.5), (0.0, MAX_TIMEOUT_S), (1e9, MAX_TIMEOUT_S)]
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
    assert not services._offers["/switch"].requests
    assert not list(services._made.of(CALLER))


def test_the_calls_of_a_caller_that_leaves_end_for_their_provider(services: Services, clock: FakeClock) -> None:
    provider = Provider(services)
    ask(services)
    services.remove(CALLER)
    assert provider.calls[0].ended
    assert clock.waiting == 0


# Names


def test_the_number_of_services_is_bounded_and_a_repeated_offer_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.graph.services.MAX_SERVICES", 2)
    services = Services(MessageTypes(REGISTRY), FakeClock().call_later)
    for name in ("/a", "/b", "/b"):
        services.offer(SERVER, name, SET_BOOL, lambda _: ON)
    with pytest.raises(GraphError, match="service /c: cannot be added: there are 2 services already"):
        services.offer(SERVER, "/c", SET_BOOL, lambda _: ON)


def test_nobody_takes_the_place_of_a_part_of_the_server_but_itself(services: Services) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: ON)
    with pytest.raises(GraphError, match="service /switch: is offered by the server itself"):
        Provider(services)
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: {"success": False})
    assert ask(services)[0].values["success"] is False


@pytest.mark.parametrize("type_name", ["std_srvs/Nothing", "std_msgs/String", "control_msgs/action/PointHead"])
def test_a_type_that_is_none_of_a_service_is_refused_and_ends_nothing(services: Services, type_name: str) -> None:
    provider = Provider(services)
    responses = ask(services)
    with pytest.raises(GraphError, match=f"service /switch: .*{type_name}"):
        services.offer_calls(Node("other", remote=True), "/switch", type_name, lambda _call: None)
    assert (responses, services.provider("/switch")) == ([], provider.node)


def test_an_error_of_one_that_hears_of_the_end_keeps_it_from_no_other(
    call: Call, responses: list[Response], caplog: pytest.LogCaptureFixture
) -> None:
    heard: list[Response] = []
    call.when_ended(lambda _end: heard[1])
    call.when_ended(heard.append)
    call.fail("stopped")
    call.fail("once more")
    assert heard == responses == [Response(ok=False, values="stopped")]
    assert "a listener to the end of a request failed" in caplog.text
