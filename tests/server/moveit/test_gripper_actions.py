from __future__ import annotations

import re
from typing import Any

import pytest

from server.moveit.gripper_actions import GRIPPER_ACTION, PARALLEL_ACTION
from tests.helpers.arm_server import ArmClient

SIMPLE, PARALLEL = "control_msgs/action/GripperCommand", "control_msgs/action/ParallelGripperCommand"
ABORTED = 6

REFUSED: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "too far": (GRIPPER_ACTION, SIMPLE, {"position": 5.0}, "from -0.145 to 1.715 rad, not 5.0"),
    "negative effort": (GRIPPER_ACTION, SIMPLE, {"position": 1.0, "max_effort": -1.0}, "effort .* not -1.0"),
    "no position": (PARALLEL_ACTION, PARALLEL, {"name": ["gripper"]}, "one value, not 0"),
    "another joint": (PARALLEL_ACTION, PARALLEL, {"name": ["elbow_flex"], "position": [0.1]}, "elbow_flex"),
    "two efforts": (PARALLEL_ACTION, PARALLEL, {"position": [0.1], "effort": [0.1, 0.2]}, "command.effort .* not 2"),
}


@pytest.mark.parametrize(("action", "type_name", "command", "words"), REFUSED.values(), ids=REFUSED.keys())
async def test_a_wrong_command_is_refused_with_field_limit_and_value(
    client: ArmClient, action: str, type_name: str, command: dict[str, Any], words: str
) -> None:
    ended = await client.result(await client.send_goal(action, type_name, {"command": command}))
    assert (ended["result"], ended["status"]) == (False, ABORTED)
    assert re.search(words, ended["values"])


async def test_the_urdfs_limit_means_as_far_as_it_goes(client: ArmClient) -> None:
    goal = await client.send_goal(GRIPPER_ACTION, SIMPLE, {"command": {"position": -0.174533}})
    assert (await client.result(goal))["values"]["reached_goal"]


async def test_a_relaxed_gripper_says_how_to_enable_it(client: ArmClient) -> None:
    await client.call("/arm/relax")
    ended = await client.result(await client.send_goal(GRIPPER_ACTION, SIMPLE, {"command": {"position": 0.5}}))
    assert (ended["result"], ended["status"]) == (False, ABORTED)
    assert "/arm/enable" in ended["values"]
