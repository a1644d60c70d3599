"""A stick on the wire: its commands expire by the clocks of client and server."""

import asyncio
from collections.abc import Callable

import numpy as np
import pytest

from harness.clients import ArmClient
from harness.waiting import TIMEOUT_S
from planners.servo.question import ServoStatus
from server.moveit.servo.servo_node import STATUS_TOPIC, TWIST_TOPIC


async def hold_the_stick(client: ArmClient, long_enough: Callable[[], bool], **linear: float) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while not long_enough():
            await client.say("publish", topic=TWIST_TOPIC, msg={"twist": {"linear": linear}})
            await asyncio.sleep(0.01)


async def test_a_stick_moves_the_arm_and_gives_way_to_a_goal(client: ArmClient) -> None:
    await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "ready"})
    await client.until("/moveit_goal_result", lambda results: results[-1]["val"] == 1)
    before = client.topics["/joint_states"][-1]["position"]
    await client.say("subscribe", topic=STATUS_TOPIC, type="moveit_msgs/ServoStatus")
    await client.say("advertise", topic=TWIST_TOPIC, type="geometry_msgs/TwistStamped")

    def moves_freely() -> bool:
        # On a busy machine the latest answer of a planner may be late, which is a status too.
        moved = client.topics["/joint_states"][-1]["position"][0] < before[0] - 0.1
        return moved and client.topics[STATUS_TOPIC][-1]["code"] == ServoStatus.NO_WARNING

    await hold_the_stick(client, moves_freely, y=0.5)
    results = len(client.topics["/moveit_goal_result"])
    await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "ready"})
    await hold_the_stick(client, lambda: client.topics[STATUS_TOPIC][-1]["code"] == ServoStatus.INVALID, y=0.5)
    assert client.topics[STATUS_TOPIC][-1]["message"]
    reached = await client.until("/moveit_goal_result", lambda all_: len(all_) > results)
    assert reached[-1]["val"] == 1
    assert client.topics["/joint_states"][-1]["position"] == pytest.approx(np.array(before), abs=0.05)
