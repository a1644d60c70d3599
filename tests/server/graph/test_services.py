import asyncio
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S
from protocol.messages import BUDGET, MAX_READ_VALUES, ListLimits
from server.errors import GraphError, ServiceError
from server.graph.permissions import Node
from server.graph.services import LOCAL_TIMEOUT_S, MAX_TIMEOUT_S, Call, Response, Services
from server.graph.topics import Graph
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import settle
from tests.helpers.messages import REGISTRY

SERVER, CALLER, PROVIDER = Node("server"), Node("caller", remote=True), Node("provider", remote=True)
SET_BOOL = "std_srvs/SetBool"
ON = {"success": True, "message": "on"}


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def services(clock: FakeClock) -> Services:
    return Graph(REGISTRY, clock, call_later=clock.call_later).services


@pytest.fixture
def provided(services: Services) -> list[Call]:
    """Calls of a service that a client offers, and answers when the test does."""
    calls: list[Call] = []
    services.offer_calls(PROVIDER, "/switch", SET_BOOL, calls.append)
    return calls


def ask(services: Services, **options: Any) -> list[Response]:
    """Call the service; what comes back lands in the list."""
    responses: list[Response] = []
    services.call(CALLER, "/switch", {}, responses.append, **options)
    return responses


# Services of local parts


REFUSED = Response(ok=True, values={"success": False, "message": "no power"})


@pytest.mark.parametrize(
    ("type_name", "refusal"), [(SET_BOOL, REFUSED), ("std_srvs/Empty", Response(ok=False, values="no power"))]
)
async def test_a_refusal_is_in_the_response_or_a_failure(services: Services, type_name: str, refusal: Response) -> None:
    async def switch(_request: dict[str, Any]) -> dict[str, Any]:
        await asyncio.sleep(0)
        raise ServiceError("no power")

    services.offer(SERVER, "/switch", type_name, switch)
    responses = ask(services)
    await settle()
    assert responses == [refusal]


def test_a_sentence_is_the_message_of_a_success(services: Services) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: "on")
    assert ask(services) == [Response(ok=True, values=ON)]


@pytest.mark.parametrize("answer", [{"success": "yes"}, {"foo": 1}, None])
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
@pytest.mark.usefixtures("provided")
def test_every_call_ends_in_time(services: Services, clock: FakeClock, timeout_s: float | None, bound_s: float) -> None:
    responses = ask(services, timeout_s=timeout_s)
    clock.advance(bound_s * 0.99)
    assert responses == []
    clock.advance(bound_s * 0.02)
    assert not responses[0].ok
    assert f"did not answer in {bound_s:g} s" in responses[0].values


def test_an_ended_call_leaves_nothing_behind(services: Services, clock: FakeClock, provided: list[Call]) -> None:
    ask(services)
    provided[0].succeed(ON)
    ask(services)
    services.remove(CALLER)
    assert provided[1].ended
    assert clock.waiting == 0
    assert not services._offers["/switch"].requests
    assert not list(services._made.of(CALLER))


# Names


def test_a_misspelt_service_is_refused_with_the_server_s_service_that_was_meant(services: Services) -> None:
    services.offer(SERVER, "/switch_on", SET_BOOL, lambda _: ON)
    services.offer_calls(PROVIDER, "/swich", SET_BOOL, lambda _call: None)
    responses: list[Response] = []
    for name in ("/swich_on", "/lamp"):
        services.call(CALLER, name, {}, responses.append)
    assert [each.values for each in responses] == [
        "Service /swich_on does not exist; did you mean /switch_on?",
        "Service /lamp does not exist",
    ]


def test_the_number_of_services_is_bounded_and_a_repeated_offer_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.graph.services.MAX_SERVICES", 2)
    services = Graph(REGISTRY).services
    for name in ("/a", "/b", "/b"):
        services.offer(SERVER, name, SET_BOOL, lambda _: ON)
    with pytest.raises(GraphError, match="service /c: cannot be added: there are 2 services already"):
        services.offer(SERVER, "/c", SET_BOOL, lambda _: ON)


def test_nobody_takes_the_place_of_a_part_of_the_server_but_itself(services: Services) -> None:
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: ON)
    with pytest.raises(GraphError, match="service /switch: is offered by the server itself"):
        services.offer_calls(PROVIDER, "/switch", SET_BOOL, lambda _call: None)
    services.offer(SERVER, "/switch", SET_BOOL, lambda _: {"success": False})
    assert ask(services)[0].values["success"] is False


@pytest.mark.parametrize("type_name", ["std_srvs/Nothing", "std_msgs/String", "control_msgs/action/PointHead"])
@pytest.mark.usefixtures("provided")
def test_a_type_that_is_none_of_a_service_is_refused_and_ends_nothing(services: Services, type_name: str) -> None:
    responses = ask(services)
    with pytest.raises(GraphError, match=f"service /switch: .*{type_name}"):
        services.offer_calls(Node("other", remote=True), "/switch", type_name, lambda _call: None)
    assert (responses, services.provider("/switch")) == ([], PROVIDER)


def test_an_error_of_one_that_hears_of_the_end_keeps_it_from_no_other(
    services: Services, provided: list[Call], caplog: pytest.LogCaptureFixture
) -> None:
    responses = ask(services)
    heard: list[Response] = []
    provided[0].when_ended(lambda _end: heard[1])
    provided[0].when_ended(heard.append)
    provided[0].fail("stopped")
    provided[0].fail("once more")
    assert heard == responses == [Response(ok=False, values="stopped")]
    assert "a listener to the end of a request failed" in caplog.text


@pytest.mark.parametrize(
    ("limits", "wanted"),
    [
        ({"limits": ListLimits({"moveit_msgs/msg/MotionSequenceRequest.items": 2})}, "2 elements"),
        # Without a word about it, there is a limit all the same.
        ({}, f"{MAX_READ_VALUES} values"),
    ],
)
def test_a_request_with_too_long_a_list_is_refused_before_it_is_completed(
    services: Services, limits: dict[str, ListLimits], wanted: str
) -> None:
    services.offer(SERVER, "/plan", "moveit_msgs/srv/GetMotionSequence", lambda _request: {}, **limits)
    ends: list[Response] = []
    services.call(CALLER, "/plan", {"request": {"items": [{}] * MAX_READ_VALUES}}, ends.append)
    assert not ends[0].ok
    assert ends[0].values.startswith(f"Service /plan: field request.items: wanted at most {wanted}")
    assert BUDGET.taken == 0
