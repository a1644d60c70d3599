from typing import Any

import pytest

from protocol.limits import Limits
from server.gateway import client_requests
from server.graph.permissions import Identity, Node, Role
from server.graph.services import Call
from tests.helpers.gateway import InProcess

TYPE = "std_srvs/SetBool"
CHECKING = "/check_goals", "armbridge_msgs/srv/CheckGoals"


@pytest.fixture
def world() -> InProcess:
    made = InProcess(Limits.model_construct(max_offers=2, max_calls_in_flight=2))
    made.say("p", op="advertise_service", service="/s", type=TYPE)
    return made


def respond(world: InProcess, number: int) -> None:
    world.say("p", op="service_response", service="/s", id=f"service_request:/s:{number}", values={}, result=True)


def test_the_number_of_offers_of_a_client_is_bounded(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    for service in ("/a", "/b"):
        world.say("p", op="advertise_service", service=service, type=TYPE)
    assert set(world.graph.services.names.types()) == {"/s", "/a"}
    world.say("p", op="advertise_service", service="/a", type="std_srvs/Trigger")
    assert world.graph.services.names.types()["/a"] == "std_srvs/srv/Trigger"
    world.say("p", op="unadvertise_service", service="/a")
    world.say("p", op="advertise_service", service="/b", type=TYPE)
    assert set(world.graph.services.names.types()) == {"/s", "/b"}
    assert "advertise_service: this client has 2, the limit is 2" in caplog.text


def test_calls_beyond_the_limit_fail_at_once_and_ended_ones_make_room(world: InProcess) -> None:
    for number in range(3):
        world.say("c", op="call_service", service="/s", id=number)
    (refused,) = world.heard("c")
    assert (refused["id"], refused["result"]) == (2, False)
    assert "2 calls of this client wait, which is the limit" in refused["values"]
    respond(world, 1)
    world.say("c", op="call_service", service="/s", id=3)
    assert [answer["id"] for answer in world.heard("c")] == [0]
    assert len(world.heard("p")) == 3


def test_a_late_response_is_never_taken_for_the_next_call(world: InProcess) -> None:
    world.say("c", op="call_service", service="/s", id="old", timeout=1)
    world.clock.advance(2.0)
    world.say("p", op="unadvertise_service", service="/s")
    world.say("p", op="advertise_service", service="/s", type=TYPE)
    world.say("c", op="call_service", service="/s", id="new")
    respond(world, 1)
    assert [answer["id"] for answer in world.heard("c")] == ["old"]


def test_calls_that_a_provider_has_no_room_for_fail_and_the_provider_stays() -> None:
    world = InProcess(Limits.model_construct(max_queued_request_bytes=10_000))
    world.say("p", op="advertise_service", service="/s", type="tf2_msgs/FrameGraph")
    world.say("p", op="advertise_service", service="/long", type="rosapi_msgs/SetParam")
    caller, provider = world.client("c"), world.client("p")
    call = '{"op":"call_service","service":"/long","args":{"value":"%s"}}' % ("x" * 6_000)
    caller.receive_frame(call * 3)
    caller.receive_frame('{"op":"call_service","service":"/s"}')
    assert not provider.session.send_queue.overflowed
    answers = world.heard("c")
    assert [answer["result"] for answer in answers] == [False, False]
    assert "does not read its calls" in answers[0]["values"]
    assert [asked["service"] for asked in world.heard("p")] == ["/long", "/s"]


def test_a_broken_response_under_an_id_that_nobody_has_does_nothing(world: InProcess) -> None:
    for mark in ("service_request:/s:1", 1, None, [1]):
        world.say("p", op="service_response", service="/s", id=mark)
    world.say("c", op="call_service", service="/s", id="x")
    assert world.heard("c") == []


async def test_a_service_that_does_not_answer_in_the_time_that_is_set_fails() -> None:
    world = InProcess(Limits.model_construct(call_timeout_s=3.0))
    world.say("p", op="advertise_service", service="/s", type=TYPE)
    world.say("c", op="call_service", service="/s", id="x", args={})
    await world.advance(2.9)
    assert world.heard("c") == []
    await world.advance(0.2)
    (response,) = world.heard("c")
    assert not response["result"]
    assert "did not answer in 3 s" in response["values"]


def calls_of(world: InProcess, service: str, type_name: str, **options: Any) -> list[Call]:
    """Offer a service that never answers; return its calls."""
    started: list[Call] = []
    world.graph.services.offer_calls(Node("p"), service, type_name, started.append, **options)
    return started


def test_calls_that_plan_are_limited_by_role() -> None:
    for role, limit, service, fields in (
        (Role.VIEW, 16, "/check_goals", {}),
        (Role.OPERATE, 64, "/check_goals", {}),
        (Role.ADMIN, 64, "/check_goals", {}),
        # Below the name of one of several arms.
        (Role.OPERATE, 64, "/left/moveit_goal", {"args": {"plan_only": True}}),
    ):
        world = InProcess(arms=("left", "right"))
        started = calls_of(world, service, "armbridge_msgs/srv/MoveitGoal")
        world.enter("c", Identity("c", role))
        for number in range(limit + 1):
            world.say("c", op="call_service", service=service, id=number, **fields)
        assert len(started) == limit
        (refused,) = world.heard("c")
        assert (refused["id"], refused["result"]) == (limit, False)
        assert f"the limit of its role is {limit}" in refused["values"]
        started[0].succeed({})
        world.say("c", op="call_service", service=service, id="next", **fields)
        assert len(started) == limit + 1


def test_a_client_that_has_left_is_answered_nothing() -> None:
    world = InProcess()
    started = calls_of(world, "/slow", "std_srvs/srv/Trigger")
    world.say("c", op="call_service", service="/slow")
    client = world.client("c")
    client.leave()
    assert started[0].ended
    assert client.session.send_queue.empty


def test_a_request_that_is_completed_in_the_background_counts_once() -> None:
    world = InProcess(Limits.model_construct(max_calls_in_flight=1))
    started = calls_of(world, *CHECKING, limits=None)
    world.say("c", op="call_service", service="/check_goals", args={"poses": [{}] * 1500})
    assert len(started) == 1
    started[0].fail("busy")
    world.say("c", op="call_service", service="/check_goals", args={})
    assert len(started) == 2


def test_values_in_calls_that_wait_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_requests, "MAX_VALUES_IN_FLIGHT", 2500)
    world = InProcess()
    started = calls_of(world, *CHECKING)
    for number in range(3):
        world.say("c", op="call_service", service="/check_goals", args={"poses": [{}] * 200}, id=number)
    assert len(started) == 2
    (refused,) = world.heard("c")
    assert (refused["id"], refused["result"]) == (2, False)
    assert "values wait, the limit is" in refused["values"]
    started[0].fail("busy")
    world.say("c", op="call_service", service="/check_goals", args={})
    assert len(started) == 3
