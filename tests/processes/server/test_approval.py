"""Goals of a client that may only propose: a person's client approves or discards them; nothing else moves the arm."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from typing import Any, NamedTuple

import pytest
from websockets.asyncio.client import connect

from harness.clients import ArmClient, arm_client, values_of
from harness.server import FAST, RunningServer
from harness.waiting import TIMEOUT_S

AGENT, PERSON = "agent-0123456789abc", "person-0123456789ab"
TOKENS = {"ARMBRIDGE_ACCESS__PROPOSE_TOKENS__AGENT": AGENT, "ARMBRIDGE_ACCESS__OPERATE_TOKENS__ADA": PERSON}
APPROVAL = "/moveit_goal_approval"


class Two(NamedTuple):
    """An agent, and the person who watches it."""

    agent: ArmClient
    person: ArmClient

    async def request(self) -> dict[str, Any]:
        """Wait for a request for approval."""
        requests = await self.person.until(APPROVAL, lambda all_: bool(all_[-1]["hardware_id"]))
        return requests[-1]

    async def approve(self, goal_id: str) -> None:
        await self.person.goal("/moveit_goal_approve", "std_msgs/String", {"data": goal_id})


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer(settings={**FAST, **TOKENS}) as running:
        yield running


@pytest.fixture
async def two(server: RunningServer) -> AsyncIterator[Two]:
    async with arm_client(f"{server.url}&token={AGENT}") as agent, arm_client(f"{server.url}&token={PERSON}") as person:
        await person.say("subscribe", topic=APPROVAL, type="diagnostic_msgs/DiagnosticStatus")
        yield Two(agent, person)
        await person.call("/arm/stop")
        await person.call("/arm/release_control")


async def test_the_agent_neither_approves_its_goal_nor_moves_the_arm_otherwise(two: Two, server: RunningServer) -> None:
    waiting = asyncio.create_task(two.agent.call("/moveit_goal", named="ready"))
    goal_id = (await two.request())["hardware_id"]
    ways: list[tuple[str, dict[str, Any]]] = [
        ("/moveit_goal_approve", {"data": goal_id}),
        ("/moveit_goal_confirm", {"data": True}),
        ("/moveit_goal_named", {"data": "home"}),
        ("/servo_node/delta_joint_cmds", {}),
        ("/arm/speed_factor", {"data": 1.0}),
    ]
    async with connect(f"{server.url}&token={AGENT}") as agent, asyncio.timeout(TIMEOUT_S):
        await agent.send(json.dumps({"op": "set_level", "level": "error"}))
        for topic, message in ways:
            await agent.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))
            refused = json.loads(await agent.recv())["msg"]
            assert f"topic {topic}: needs the role operate, this client has propose" in refused
    second = await two.agent.call("/moveit_goal", named="home")
    assert "waits for approval; one proposed goal is taken at a time" in second["message"]
    assert not waiting.done()
    # Every client may stop, and the approval that comes too late moves nothing.
    assert (await two.agent.call("/arm/stop"))["success"]
    assert (await waiting)["code_name"] == "PREEMPTED"
    await two.approve(goal_id)
    assert values_of((await two.person.until("/arm/state", bool))[-1])["mode"] == "holding"
