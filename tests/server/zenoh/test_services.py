import asyncio
import functools
from typing import Any

import pytest
import zenoh

from harness.waiting import until
from protocol.codecs import cdr
from protocol.type_descriptions import service_hash
from server.errors import ServiceError
from server.zenoh import services
from server.zenoh.rmw import Endpoint
from tests.helpers.messages import REGISTRY
from tests.helpers.zenoh_network import TRIGGER_KEY, RosMachine, Site, attached, networked

TRIGGER = "std_srvs/srv/Trigger"
DONE = b"\x00\x01\x00\x00\x01\x00\x00\x00\x05\x00\x00\x00done\x00"


def offered(site: Site, name: str = "/arm/stop") -> list[dict[str, Any]]:
    """Offer a service as a part of the server; returns its requests as they come."""
    requests: list[dict[str, Any]] = []

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        requests.append(request)
        return {"success": True, "message": "done"}

    site.graph.services.offer(site.part, name, TRIGGER, answer)
    return requests


async def replies(machine: RosMachine, service: str = "/arm/stop", **how: Any) -> list[zenoh.Reply]:
    await until(lambda: machine.has_token(f"/SS/%/%/armbridge/{service.replace('/', '%')}/"))
    return await asyncio.to_thread(machine.call, service, **how)


def failure(reply: zenoh.Reply) -> str:
    """The sentence by which a call has failed."""
    assert reply.err is not None
    return bytes(reply.err.payload).decode()


async def test_a_ros_2_machine_calls_what_fits_a_pattern_until_it_is_withdrawn_and_knows_its_answer_again() -> None:
    async with networked(offer=("/arm/stop",)) as (site, machine):
        requests, others = offered(site), offered(site, "/arm/enable")
        (reply,) = await replies(machine, number=42)
        assert len(requests) == 1
        assert await asyncio.to_thread(machine.call, "/arm/enable") == others == []
        site.graph.services.withdraw(site.part, "/arm/stop")
        await until(lambda: not machine.has_token("%arm%stop"))
        assert await asyncio.to_thread(machine.call, "/arm/stop") == []
    assert reply.ok is not None
    assert (str(reply.ok.key_expr), bytes(reply.ok.payload)) == (f"0/arm/stop/{TRIGGER_KEY}", DONE)
    answered, asked = bytes(reply.ok.attachment or b""), attached(42)
    assert (answered[:8], answered[16:]) == (asked[:8], asked[16:])


async def test_a_query_for_many_keys_calls_no_service() -> None:
    async with networked(offer=("/arm/*",)) as (site, machine):
        requests = offered(site)
        await until(lambda: machine.has_token("%arm%stop"))
        ask, request = machine.session.get, b"\0\1\0\0\0"
        for asked, payload in (("0/**", None), (f"0/arm/stop/{TRIGGER_KEY}", None), ("0/arm/**", request)):
            assert await asyncio.to_thread(lambda to=asked, what=payload: list(ask(to, payload=what))) == []
    assert requests == []


async def test_a_service_that_refuses_says_why_in_its_response() -> None:
    def refuse(_request: dict[str, Any]) -> dict[str, Any]:
        raise ServiceError("the arm is not there")

    async with networked(offer=("/arm/*",)) as (site, machine):
        site.graph.services.offer(site.part, "/arm/stop", TRIGGER, refuse)
        (reply,) = await replies(machine)
    assert reply.ok is not None
    assert bytes(reply.ok.payload) == b"\0\1\0\0\0\0\0\0\x15\0\0\0the arm is not there\0"


@pytest.mark.parametrize(
    ("max_bytes", "payload"), [(100, b"\xff"), (4, b"\0\1\0\0\0")], ids=["unreadable", "too large"]
)
async def test_a_bad_request_is_refused(max_bytes: int, payload: bytes) -> None:
    async with networked(max_message_bytes=max_bytes, offer=("/arm/*",)) as (site, machine):
        requests = offered(site)
        refused, answered = await replies(machine, payload=payload)
    assert requests == []
    assert failure(refused).startswith("Service /arm/stop: message: wanted CDR")
    # rmw_zenoh logs the refusal, and waits for a response.
    assert answered.ok is not None
    assert bytes(answered.ok.payload)[4] == 0
    assert failure(refused).encode() in bytes(answered.ok.payload)


@pytest.mark.parametrize(
    ("name", "parts"),
    [("GetPositionFK", ()), ("GetMotionPlan", ("motion_plan_response",)), ("GetMotionSequence", ("response",))],
)
async def test_a_refused_call_is_answered_by_the_error_code_in_its_response(name: str, parts: tuple[str, ...]) -> None:
    service_type = f"moveit_msgs/srv/{name}"
    async with networked(offer=("/compute",)) as (site, machine):
        site.graph.services.offer(site.part, "/compute", service_type, lambda _request: {})
        key = Endpoint("/compute", service_type, service_hash(REGISTRY, service_type)).key(0)
        refused, answered = await replies(machine, "/compute", payload=b"\xff", key=key)
    assert answered.ok is not None
    response = cdr.deserialize(REGISTRY, f"{service_type}_Response", bytes(answered.ok.payload))
    code = functools.reduce(dict.__getitem__, (*parts, "error_code"), response)
    assert (code["val"], code["message"]) == (99999, failure(refused))


async def test_a_refused_call_whose_response_cannot_say_so_gets_no_response() -> None:
    async with networked(offer=("/compute",)) as (site, machine):
        service_type = "moveit_msgs/srv/GetPlanningScene"
        site.graph.services.offer(site.part, "/compute", service_type, lambda _request: {})
        key = Endpoint("/compute", service_type, service_hash(REGISTRY, service_type)).key(0)
        (refused,) = await replies(machine, "/compute", payload=b"\xff", key=key)
    assert "wanted CDR" in failure(refused)


async def test_a_viewing_network_is_told_the_missing_role_but_may_stop_the_arm() -> None:
    async with networked(offer=("/arm/*",), role="view") as (site, machine):
        requests = offered(site, "/arm/enable")
        offered(site)
        (refused, _), (stopped,) = await replies(machine, "/arm/enable"), await replies(machine)
    assert requests == []
    assert "needs the role operate" in failure(refused)
    assert stopped.ok is not None


async def test_of_too_many_calls_those_beyond_are_refused_but_no_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "MAX_INCOMING_CALLS", 2)
    monkeypatch.setattr(services, "MAX_INCOMING_STOPS", 1)
    enable, go_on = "/arm/enable", asyncio.Event()

    async def answer(_request: dict[str, Any]) -> dict[str, Any]:
        await go_on.wait()
        return {"success": True, "message": "done"}

    async with networked(offer=("/arm/*",)) as (site, machine):
        site.graph.services.offer(site.part, enable, TRIGGER, answer)
        offered(site)
        first = [asyncio.create_task(replies(machine, enable)) for _ in range(2)]
        await until(lambda: len(site.calls_of(enable)) == 2)
        (refused, _), (stopped,) = await replies(machine, enable), await replies(machine)
        go_on.set()
        answered = [(await call)[0] for call in first]
        (later,) = await replies(machine, enable)
    assert failure(refused) == "Service /arm/enable: 2 calls are on their way already"
    assert all(reply.ok is not None for reply in (*answered, stopped, later))


class Offering:
    """A std_srvs/Trigger on a ROS 2 machine."""

    def __init__(self, machine: RosMachine, service: str = "/lamp/switch", response: bytes | None = DONE) -> None:
        self.queries: list[tuple[bytes, bytes]] = []
        self._response = response
        self._key = f"0{service}/{TRIGGER_KEY}"
        self._held: list[zenoh.Query] = []
        machine.session.declare_queryable(self._key, self._answer, complete=True)
        self.token = machine.announce("SS", service, TRIGGER_KEY)

    def give_up(self) -> None:
        """End the calls without a response."""
        while self._held:
            self._held.pop().drop()

    def _answer(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        assert query.attachment is not None
        self.queries.append((bytes(query.payload), bytes(query.attachment)))
        if self._response is None:
            self._held.append(query)
        else:
            query.reply(self._key, self._response, attachment=query.attachment)


async def found_by(site: Site, service: str = "/lamp/switch") -> None:
    await until(lambda: site.graph.services.names.type_of(service) == "std_srvs/srv/Trigger")


async def test_a_client_calls_a_service_of_a_ros_2_machine_that_fits_a_pattern() -> None:
    async with networked(call=("/lamp/*",)) as (site, machine):
        Offering(machine, "/door/open")
        offering = Offering(machine)
        await found_by(site)
        response = await site.called("/lamp/switch")
        again = await site.called("/lamp/switch")
    assert site.graph.services.names.type_of("/door/open") is None
    assert response.values == again.values == {"success": True, "message": "done"}
    # An empty request is one octet; the calls are counted.
    assert [payload for payload, _ in offering.queries] == [b"\x00\x01\x00\x00\x00"] * 2
    numbers = [int.from_bytes(attachment[:8], "little") for _, attachment in offering.queries]
    assert (numbers, {len(attachment) for _, attachment in offering.queries}) == ([1, 2], {33})


async def test_a_service_that_goes_is_gone_and_calls_on_their_way_fail() -> None:
    async with networked(call=("/lamp/*",)) as (site, machine):
        offering = Offering(machine, response=None)
        await found_by(site)
        call = asyncio.create_task(site.called("/lamp/switch"))
        await until(lambda: offering.queries)
        machine.session.close()
        response = await call
        await until(lambda: site.graph.services.names.type_of("/lamp/switch") is None)
    assert not response.ok
    assert "/lamp/switch" in response.values


async def test_a_bad_response_fails_the_call() -> None:
    for response, sentence in (
        (b"nonsense", "gave a response that does not fit std_srvs/srv/Trigger"),
        (DONE + b"x", f"gave a response of more than {len(DONE)} bytes"),
    ):
        async with networked(max_message_bytes=len(DONE), call=("/lamp/*",)) as (site, machine):
            Offering(machine, response=response)
            await found_by(site)
            answer = await site.called("/lamp/switch")
        assert not answer.ok, response
        assert sentence in answer.values


async def test_a_name_that_is_taken_here_keeps_its_service(caplog: pytest.LogCaptureFixture) -> None:
    here = {"success": True, "message": "here"}
    async with networked(call=("/lamp/*",)) as (site, machine):
        site.graph.services.offer(site.client, "/lamp/switch", "std_srvs/Trigger", lambda _request: here)
        Offering(machine)
        Offering(machine, "/lamp/other")
        await found_by(site, "/lamp/other")
        response = await site.called("/lamp/switch")
    assert response.values["message"] == "here"
    assert "/lamp/switch of another machine cannot be called" in caplog.text


async def test_of_too_many_calls_at_a_time_those_beyond_fail_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "MAX_OUTGOING_CALLS", 1)
    async with networked(call=("/lamp/*",)) as (site, machine):
        offering = Offering(machine, response=None)
        await found_by(site)
        waiting = asyncio.create_task(site.called("/lamp/switch"))
        await until(lambda: offering.queries)
        response = await site.called("/lamp/switch")
        offering.give_up()
        unanswered = await waiting
        again = asyncio.create_task(site.called("/lamp/switch"))
        await until(lambda: len(offering.queries) == 2)
        offering.give_up()
        await again
    assert unanswered.values == "Service /lamp/switch has not answered"
    assert response.values == "Service /lamp/switch: 1 calls are on their way already"
