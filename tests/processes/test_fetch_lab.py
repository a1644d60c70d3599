"""A laboratory's program for a Fetch, as it was written for rosbridge and MoveIt of ROS 1, on the simulated arm."""

import asyncio
import itertools
import json
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import ClientConnection, connect

from harness.server import FAST, ROOT, RunningServer
from harness.waiting import TIMEOUT_S, running
from robot.description import robot_folder
from robot.description.forward_kinematics import ForwardPlacements

# Each wave is over within this time, or is cancelled.
DEADLINE_S = 30.0
TOLERANCE = 0.01

# Fingers forward and up, to the left and to the right, in base_link.
ORIENTATION = (0.0, -0.3826834, 0.0, 0.9238795)
LEFT, RIGHT = (0.55, 0.3, 1.15), (0.55, -0.3, 1.15)
OUT_OF_REACH = (2.0, 0.0, 1.0)

SUCCEEDED, PREEMPTED, ABORTED = 3, 2, 4
NAMES = {1: "SUCCESS", -7: "PREEMPTED", -31: "NO_IK_SOLUTION"}


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer("--port 0 --robot fetch", settings=FAST) as running:
        yield running


class LabClient:
    """The action ``/move_group`` by actionlib's topics, in ROS 1's spelling."""

    def __init__(self, websocket: ClientConnection) -> None:
        self._websocket = websocket
        self._numbers = itertools.count(1)
        self.received: dict[str, list[dict[str, Any]]] = {}
        self._news = asyncio.Condition()
        self.reader = asyncio.create_task(self._read())

    async def open(self) -> None:
        for part, type_name in (
            ("result", "moveit_msgs/MoveGroupActionResult"),
            ("status", "actionlib_msgs/GoalStatusArray"),
            ("feedback", "moveit_msgs/MoveGroupActionFeedback"),
        ):
            await self._say("subscribe", topic=f"/move_group/{part}", type=type_name)
        await self._say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        await self._say("advertise", topic="/move_group/goal", type="moveit_msgs/MoveGroupActionGoal")
        await self._say("advertise", topic="/move_group/cancel", type="actionlib_msgs/GoalID")

    async def send(self, position: tuple[float, ...], orientation: tuple[float, ...] = ORIENTATION) -> str:
        """Send a goal; returns its id."""
        now = time.time()
        stamp = {"secs": int(now), "nsecs": int(now % 1 * 1e9)}
        name = f"lab-{next(self._numbers)}-{now}"
        hand = {"header": {"frame_id": "base_link", "stamp": stamp}, "link_name": "gripper_link", "weight": 1.0}
        pose = {"position": dict(zip("xyz", position, strict=True)), "orientation": {"w": 1.0}}
        region = {"primitives": [{"type": 2, "dimensions": [TOLERANCE]}], "primitive_poses": [pose]}
        turn = {f"absolute_{axis}_axis_tolerance": TOLERANCE for axis in "xyz"}
        turn |= {"orientation": dict(zip("xyzw", orientation, strict=True))}
        request = {
            "group_name": "arm",
            "num_planning_attempts": 1,
            "allowed_planning_time": 5.0,
            "goal_constraints": [
                {
                    "position_constraints": [hand | {"constraint_region": region}],
                    "orientation_constraints": [hand | turn],
                }
            ],
        }
        goal = {"request": request, "planning_options": {"plan_only": False}}
        message = {"header": {"stamp": stamp}, "goal_id": {"stamp": stamp, "id": name}, "goal": goal}
        await self._say("publish", topic="/move_group/goal", msg=message)
        return name

    async def cancel_all(self) -> None:
        await self._say("publish", topic="/move_group/cancel", msg={"stamp": {"secs": 0, "nsecs": 0}, "id": ""})

    async def result(self, name: str) -> dict[str, Any]:
        """The result of a goal, which must come within the deadline."""
        return await self.until("result", lambda message: message["status"]["goal_id"]["id"] == name)

    async def until(self, part: str, condition: Any) -> dict[str, Any]:
        topic = part if part.startswith("/") else f"/move_group/{part}"
        async with asyncio.timeout(DEADLINE_S), self._news:
            while True:
                for message in self.received.get(topic, []):
                    if condition(message):
                        return message
                await self._news.wait()

    async def wave(self, position: tuple[float, ...]) -> str:
        """Move the hand to a pose; returns the result's name."""
        return NAMES[(await self.result(await self.send(position)))["result"]["error_code"]["val"]]

    async def _say(self, op: str, **fields: Any) -> None:
        await self._websocket.send(json.dumps({"op": op, **fields}))

    async def _read(self) -> None:
        async for frame in self._websocket:
            operation = json.loads(frame)
            async with self._news:
                self.received.setdefault(operation.get("topic", "?"), []).append(operation.get("msg", operation))
                self._news.notify_all()


@asynccontextmanager
async def lab_client(server: RunningServer) -> AsyncIterator[LabClient]:
    async with connect(f"ws://127.0.0.1:{server.port}/?ros=1", max_size=None) as websocket:
        client = LabClient(websocket)
        await client.open()
        try:
            yield client
        finally:
            client.reader.cancel()


@pytest.fixture
async def lab(server: RunningServer) -> AsyncIterator[LabClient]:
    async with lab_client(server) as client:
        yield client


async def test_the_hand_is_where_and_as_it_was_asked_to_be(lab: LabClient) -> None:
    result = await lab.result(await lab.send(RIGHT))
    assert result["status"]["status"] == SUCCEEDED
    seen = len(lab.received["/joint_states"])
    await lab.until("/joint_states", lambda _: len(lab.received["/joint_states"]) > seen + 1)
    state = lab.received["/joint_states"][-1]
    reached = ForwardPlacements(robot_folder.built_in("fetch").model).transforms(
        dict(zip(state["name"], state["position"], strict=True))
    )
    np.testing.assert_allclose(reached["gripper_link"][:3, 3], RIGHT, atol=TOLERANCE + 0.005)
    # The quaternion is half an eighth turn about -y: the fingers point forward and up alike.
    eighth = np.sqrt(0.5)
    np.testing.assert_allclose(reached["gripper_link"][:3, 0], (eighth, 0.0, eighth), atol=2.0 * TOLERANCE + 0.005)


async def test_a_pose_out_of_reach_has_its_error_code_and_a_sentence(lab: LabClient) -> None:
    result = await lab.result(await lab.send(OUT_OF_REACH))
    assert NAMES[result["result"]["error_code"]["val"]] == "NO_IK_SOLUTION"
    assert result["status"]["status"] == ABORTED
    assert "gripper_link" in result["status"]["text"]


async def test_a_cancel_without_an_id_ends_all_goals_and_the_arm_stands(lab: LabClient) -> None:
    await lab.wave(LEFT)
    name = await lab.send(RIGHT)
    await lab.until("feedback", lambda each: each["status"]["goal_id"]["id"] == name)
    await lab.cancel_all()
    result = await lab.result(name)
    assert NAMES[result["result"]["error_code"]["val"]] == "PREEMPTED"
    assert result["status"]["status"] == PREEMPTED
    assert await lab.wave(LEFT) == "SUCCESS"


def test_the_example_waves_until_ctrl_c_and_leaves_no_goal(server: RunningServer) -> None:
    command = [sys.executable, str(ROOT / "examples" / "fetch_wave.py"), "--url", server.url]
    with running(command, stdout=subprocess.PIPE) as wave:
        assert wave.stdout is not None
        lines = [wave.stdout.readline() for _ in range(2)]
        wave.send_signal(signal.SIGINT)
        rest, _ = wave.communicate(timeout=TIMEOUT_S)
    assert lines == ["SUCCESS\n", "SUCCESS\n"]
    assert wave.returncode == 0
    # Empty where the signal came between two goals.
    assert rest in ("", "PREEMPTED\n")
