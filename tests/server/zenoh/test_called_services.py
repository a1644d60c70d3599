from __future__ import annotations

import asyncio
from typing import Any

import pytest
import zenoh

from server.zenoh import called_services
from tests.helpers.zenoh_network import TRIGGER_KEY, RosMachine, Site, free_port, until

DONE = b"\x00\x01\x00\x00\x01\x00\x00\x00\x05\x00\x00\x00done\x00"


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


async def offered(site: Site, service: str = "/lamp/switch") -> None:
    await until(lambda: site.graph.services.type_of(service) == "std_srvs/srv/Trigger")


async def test_a_client_calls_a_service_of_a_ros_2_machine() -> None:
    port = free_port()
    async with Site(port, call=("/lamp/*",)) as site:
        with RosMachine(port) as machine:
            offering = Offering(machine)
            await offered(site)
            response = await site.called("/lamp/switch")
            again = await site.called("/lamp/switch")
    assert response.values == again.values == {"success": True, "message": "done"}
    # An empty request is one octet; the calls are counted.
    assert [payload for payload, _ in offering.queries] == [b"\x00\x01\x00\x00\x00"] * 2
    assert [int.from_bytes(attachment[:8], "little") for _, attachment in offering.queries] == [1, 2]
    assert {len(attachment) for _, attachment in offering.queries} == {33}


async def test_a_service_that_goes_is_gone_and_calls_on_their_way_fail() -> None:
    port = free_port()
    async with Site(port, call=("/lamp/*",)) as site:
        with RosMachine(port) as machine:
            offering = Offering(machine, response=None)
            await offered(site)
            call = asyncio.create_task(site.called("/lamp/switch"))
            await until(lambda: offering.queries)
        response = await call
        await until(lambda: site.graph.services.type_of("/lamp/switch") is None)
    assert not response.ok
    assert "/lamp/switch" in response.values


async def test_a_response_that_cannot_be_read_fails_the_call() -> None:
    port = free_port()
    async with Site(port, call=("/lamp/*",)) as site:
        with RosMachine(port) as machine:
            Offering(machine, response=b"nonsense")
            await offered(site)
            response = await site.called("/lamp/switch")
    assert not response.ok
    assert "gave a response that does not fit std_srvs/srv/Trigger" in response.values


async def test_a_response_that_is_too_large_fails_the_call() -> None:
    port = free_port()
    async with Site(port, max_message_bytes=len(DONE) - 1, call=("/lamp/*",)) as site:
        with RosMachine(port) as machine:
            Offering(machine)
            await offered(site)
            response = await site.called("/lamp/switch")
    assert response.values == f"Service /lamp/switch gave a response of more than {len(DONE) - 1} bytes"


async def test_a_name_that_is_taken_here_keeps_its_service(caplog: pytest.LogCaptureFixture) -> None:
    port = free_port()

    def answer(_request: dict[str, Any]) -> dict[str, Any]:
        return {"success": True, "message": "here"}

    async with Site(port, call=("/lamp/*",)) as site:
        site.graph.services.offer(site.client, "/lamp/switch", "std_srvs/Trigger", answer)
        with RosMachine(port) as machine:
            Offering(machine)
            Offering(machine, "/lamp/other")
            await offered(site, "/lamp/other")
            response = await site.called("/lamp/switch")
    assert response.values["message"] == "here"
    assert "/lamp/switch of another machine cannot be called" in caplog.text


async def test_services_that_fit_no_pattern_are_not_there() -> None:
    port = free_port()
    async with Site(port, call=("/lamp/*",)) as site:
        with RosMachine(port) as machine:
            Offering(machine, "/door/open")
            Offering(machine)
            await offered(site)
    assert site.graph.services.type_of("/door/open") is None


async def test_of_too_many_calls_at_a_time_those_beyond_fail_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(called_services, "MAX_CALLS_IN_FLIGHT", 1)
    port = free_port()
    async with Site(port, call=("/lamp/*",)) as site:
        with RosMachine(port) as machine:
            offering = Offering(machine, response=None)
            await offered(site)
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
