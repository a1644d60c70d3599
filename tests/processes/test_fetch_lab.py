"""A laboratory's program for a Fetch, as it was written for rosbridge and MoveIt of ROS 1, on the simulated arm."""

import itertools
import re
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest

from harness.clients import ArmClient, arm_client
from harness.server import FAST, ROOT, RunningServer
from harness.waiting import TIMEOUT_S, running
from robot.description import robot_folder
from robot.description.forward_kinematics import ForwardPlacements

ARGUMENTS = "--port 0 --robot fetch"
SETTINGS = FAST

TOLERANCE = 0.01
# Fingers forward and up, in base_link.
ORIENTATION = (0.0, -0.3826834, 0.0, 0.9238795)
RIGHT = (0.55, -0.3, 1.15)
OUT_OF_REACH = (2.0, 0.0, 1.0)
SUCCEEDED, PREEMPTED, ABORTED = 3, 2, 4
NO_IK_SOLUTION = -31
NUMBERS = itertools.count(1)


@pytest.fixture
async def lab(server: RunningServer) -> AsyncIterator[ArmClient]:
    """A client of the action ``/move_group`` by actionlib's topics, in ROS 1's spelling."""
    async with arm_client(f"{server.url}&ros=1") as client:
        await client.subscribe("/move_group/result", "moveit_msgs/MoveGroupActionResult")
        await client.subscribe("/move_group/feedback", "moveit_msgs/MoveGroupActionFeedback")
        await client.say("advertise", topic="/move_group/goal", type="moveit_msgs/MoveGroupActionGoal")
        await client.say("advertise", topic="/move_group/cancel", type="actionlib_msgs/GoalID")
        yield client


async def send(lab: ArmClient, position: tuple[float, ...]) -> str:
    """Send the hand to a place; returns the goal's id."""
    now = time.time()
    stamp = {"secs": int(now), "nsecs": int(now % 1 * 1e9)}
    name = f"lab-{next(NUMBERS)}-{now}"
    hand = {"header": {"frame_id": "base_link", "stamp": stamp}, "link_name": "gripper_link", "weight": 1.0}
    pose = {"position": dict(zip("xyz", position, strict=True)), "orientation": {"w": 1.0}}
    region = {"primitives": [{"type": 2, "dimensions": [TOLERANCE]}], "primitive_poses": [pose]}
    turn = {f"absolute_{axis}_axis_tolerance": TOLERANCE for axis in "xyz"}
    turn |= {"orientation": dict(zip("xyzw", ORIENTATION, strict=True))}
    constraints = {
        "position_constraints": [hand | {"constraint_region": region}],
        "orientation_constraints": [hand | turn],
    }
    request = {"group_name": "arm", "allowed_planning_time": 60.0, "goal_constraints": [constraints]}
    goal = {"request": request, "planning_options": {"plan_only": False}}
    goal_id = {"stamp": stamp, "id": name}
    await lab.publish("/move_group/goal", {"header": {"stamp": stamp}, "goal_id": goal_id, "goal": goal})
    return name


async def until_of(lab: ArmClient, part: str, name: str) -> dict[str, Any]:
    """The latest message about a goal."""
    about = await lab.until(f"/move_group/{part}", lambda all_: all_[-1]["status"]["goal_id"]["id"] == name)
    return about[-1]


async def test_the_hand_is_where_and_as_it_was_asked_to_be(lab: ArmClient) -> None:
    result = await until_of(lab, "result", await send(lab, RIGHT))
    assert result["status"]["status"] == SUCCEEDED
    reached = ForwardPlacements(robot_folder.built_in("fetch").model).transforms(await lab.positions())["gripper_link"]
    np.testing.assert_allclose(reached[:3, 3], RIGHT, atol=TOLERANCE + 0.005)
    # The quaternion is half an eighth turn about -y: the fingers point forward and up alike.
    eighth = np.sqrt(0.5)
    np.testing.assert_allclose(reached[:3, 0], (eighth, 0.0, eighth), atol=2.0 * TOLERANCE + 0.005)


async def test_a_cancel_without_an_id_ends_all_goals_and_a_pose_out_of_reach_has_its_code(lab: ArmClient) -> None:
    await lab.set_speed(0.1)
    name = await send(lab, (0.55, 0.3, 1.15))
    await until_of(lab, "feedback", name)
    await lab.publish("/move_group/cancel", {"stamp": {"secs": 0, "nsecs": 0}, "id": ""})
    result = await until_of(lab, "result", name)
    await lab.set_speed(1.0)
    assert (result["result"]["error_code"]["val"], result["status"]["status"]) == (-7, PREEMPTED)
    result = await until_of(lab, "result", await send(lab, OUT_OF_REACH))
    assert (result["result"]["error_code"]["val"], result["status"]["status"]) == (NO_IK_SOLUTION, ABORTED)
    assert "gripper_link" in result["status"]["text"]


def test_the_example_waves_until_ctrl_c_and_leaves_no_goal(server: RunningServer) -> None:
    command = [sys.executable, str(ROOT / "examples" / "fetch_wave.py"), "--url", server.url]
    with running(command, stdout=subprocess.PIPE) as wave:
        assert wave.stdout is not None
        lines = [wave.stdout.readline() for _ in range(2)]
        wave.send_signal(signal.SIGINT)
        rest, _ = wave.communicate(timeout=TIMEOUT_S)
    assert lines == ["SUCCESS\n", "SUCCESS\n"]
    assert wave.returncode == 0
    # Where the signal came between two goals, none is preempted.
    assert re.fullmatch(r"(SUCCESS\n)*(PREEMPTED\n)?", rest)
