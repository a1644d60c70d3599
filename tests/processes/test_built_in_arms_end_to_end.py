"""A simulated arm with servos of Dynamixel's is driven by goals over a real socket."""

import pytest

from harness.clients import ArmClient
from tests.helpers.dynamixel import KOCH

ARGUMENTS = "--port 0 --robot koch_v1_1"

# Backlash of the goal's ticks [rad].
ARRIVED = 0.03


async def test_arm_and_gripper_go_to_each_of_their_named_states(caller: ArmClient) -> None:
    for name, wanted in KOCH.model.named_states["arm"].items():
        assert (await caller.call("/moveit_goal", named=name))["message"] == "the arm is there"
        at = await caller.positions()
        assert {joint: at[joint] for joint in wanted} == pytest.approx(wanted, abs=ARRIVED), name
    for wanted in KOCH.model.named_states["gripper"].values():
        command = {"command": {"position": wanted["gripper"], "max_effort": 0.0}}
        action, type_name = "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand"
        assert (await caller.result(await caller.send_goal(action, type_name, command)))["result"]
        assert (await caller.positions())["gripper"] == pytest.approx(wanted["gripper"], abs=ARRIVED)
