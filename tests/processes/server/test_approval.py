"""Goals of a client that may only propose: a person's client approves or discards them; nothing else moves the arm."""

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import connect

from harness.clients import ArmClient, arm_client, values_of
from harness.server import FAST, RunningServer
from harness.waiting import TIMEOUT_S

AGENT, PERSON = "agent-0123456789abc", "person-0123456789ab"
SETTINGS = {**FAST, "ARMBRIDGE_ACCESS__PROPOSE_TOKENS__AGENT": AGENT, "ARMBRIDGE_ACCESS__OPERATE_TOKENS__ADA": PERSON}
APPROVAL = "/moveit_goal_approval"


@pytest.fixture
async def caller(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(f"{server.url}&token={AGENT}") as agent:
        yield agent


@pytest.fixture
async def person(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(f"{server.url}&token={PERSON}") as watching:
        await watching.subscribe(APPROVAL, "diagnostic_msgs/DiagnosticStatus")
        yield watching


async def test_the_agent_neither_approves_its_goal_nor_moves_the_arm_otherwise(
    server: RunningServer, caller: ArmClient, person: ArmClient
) -> None:
    waiting = asyncio.create_task(caller.call("/moveit_goal", named="ready"))
    requests = await person.until(APPROVAL, lambda all_: bool(all_[-1]["hardware_id"]))
    goal_id = requests[-1]["hardware_id"]
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
    second = await caller.call("/moveit_goal", named="home")
    assert "waits for approval; one proposed goal is taken at a time" in second["message"]
    assert not waiting.done()
    # Every client may stop, and the approval that comes too late moves nothing.
    assert (await caller.call("/arm/stop"))["success"]
    assert (await waiting)["code_name"] == "PREEMPTED"
    await person.goal("/moveit_goal_approve", "std_msgs/String", {"data": goal_id})
    assert values_of((await person.until("/arm/state", bool))[-1])["mode"] == "holding"
