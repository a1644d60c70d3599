"""The ends of a server whose arm is to be parked, by the servos' log."""

import asyncio
import re
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from harness.clients import ArmClient, arm_client, publish
from harness.server import FAST_ARMS, RunningServer, read_write_log
from harness.waiting import TIMEOUT_S, wait_until
from robot.description.robot_folder import built_in
from tests.helpers.moveit import box
from tests.helpers.resources import runs
from tests.server.conftest import JOINTS

REST = built_in("so101").model.named_states["arm"]["rest"]

# Speed factor with which the way to the rest pose lasts longer than any test is late.
SLOW = 0.05

# A relaxed elbow sinks until its stop holds it.
SINK_RAD = 0.1

CONFIG = """
[arm]
on_exit = "park"
on_server_lost = "park"
[emulator]
write_log = "{folder}/arm.jsonl"
"""
TWO_ARMS = """
[arms.left]
on_server_lost = "park"
base_xyz_m = [0.0, 0.25, 0.0]
emulator.write_log = "{folder}/left.jsonl"
[arms.right]
on_server_lost = "park"
base_xyz_m = [0.0, -0.25, 0.0]
emulator.write_log = "{folder}/right.jsonl"
"""


@dataclass
class Parked:
    """A server whose arms are to be parked, and the folder of their servos' logs."""

    server: RunningServer
    folder: Path

    @property
    def text(self) -> str:
        return "\n".join(list(self.server.lines))

    def until_known(self, count: int = 1) -> None:
        """Wait until the arm processes know so many ways to the rest pose, one after the other."""
        wait_until(lambda: self.text.count("the way to the rest pose is known") >= count)

    def until_arms_end(self) -> None:
        """Wait for the end of the server, and of its arm processes."""
        self.server.process.wait(TIMEOUT_S)
        for pid in re.findall(r"process (\d+), 100 Hz", self.text):
            wait_until(lambda pid=int(pid): not runs(pid))

    def kill(self) -> None:
        self.server.process.kill()
        self.until_arms_end()

    def last_write(self, arm: str) -> dict[str, Any]:
        return read_write_log(self.folder / f"{arm}.jsonl")[-1]

    def relaxed(self, arm: str = "arm") -> bool:
        return set(self.last_write(arm)["torque"].values()) == {0}

    def rests(self, arm: str = "arm") -> bool:
        """Tell whether an arm was relaxed near its rest pose; elsewhere is far away."""
        present = self.last_write(arm)["present"]
        away_rad = max(
            abs(JOINTS[name].rad_from_ticks(present[str(JOINTS[name].servo_id)]) - position)
            for name, position in REST.items()
        )
        assert away_rad < SINK_RAD or away_rad > 0.3
        return self.relaxed(arm) and away_rad < SINK_RAD


@pytest.fixture
def parking(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Parked]:
    """A server with the configuration that a test names, or with one arm."""
    config = tmp_path / "arms.toml"
    config.write_text(getattr(request, "param", CONFIG).format(folder=tmp_path))
    with RunningServer(f"--port 0 --log-level debug --config {config}", FAST_ARMS) as server:
        yield Parked(server, tmp_path)


async def begin_to_move(client: ArmClient) -> None:
    """Return on the way from where every joint is at 0, so slowly that it lasts however late the test goes on.

    The speed is that of the goal: parking has its own.
    """
    goal = {"joint_constraints": [{"joint_name": "shoulder_pan", "position": 1.5}]}
    request = {"group_name": "arm", "goal_constraints": [goal], "max_velocity_scaling_factor": 0.03}
    await client.send_goal("/move_action", "moveit_msgs/action/MoveGroup", {"request": request})
    await client.until("/joint_states", lambda states: states[-1]["position"][0] > 0.1)


async def test_a_server_that_is_killed_in_mid_motion_leaves_a_parked_arm(parking: Parked) -> None:
    parking.until_known()
    async with arm_client(parking.server.url) as client:
        await begin_to_move(client)
        parking.kill()
    assert "goes back along its path" in parking.text
    assert parking.rests()


async def test_an_orderly_end_parks_from_wherever_the_arm_comes_to_rest(parking: Parked) -> None:
    async with arm_client(parking.server.url) as client:
        await begin_to_move(client)
    assert parking.server.end(signal.SIGTERM)[0] == 0
    assert parking.rests()


def test_a_second_signal_has_the_arm_relaxed_instead(parking: Parked) -> None:
    parking.until_known()
    publish(parking.server.url, "/arm/speed_factor", "std_msgs/Float64", {"data": SLOW})
    parking.server.process.send_signal(signal.SIGINT)
    assert parking.server.has_logged("the arm moves to its rest pose")
    assert parking.server.end(signal.SIGINT)[0] == 0
    parking.until_arms_end()
    assert "must not wait" in parking.text
    assert parking.relaxed()


async def test_a_scene_in_which_there_is_no_way_has_the_arm_relaxed_where_it_is(parking: Parked) -> None:
    parking.until_known()
    async with arm_client(parking.server.url) as client, arm_client(parking.server.url) as other:
        # A stop keeps the arm from being relaxed.
        await client.set_speed(SLOW)
        call = asyncio.create_task(client.call("/arm/park"))
        await client.until_mode("moving")
        await other.call("/arm/stop")
        assert not (await call)["success"]
        await client.set_speed(1.0)
        await client.until_mode("holding")
        await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "home"})
        await client.until("/moveit_goal_result", lambda results: results[-1]["val"] == 1)
        # A box in the way of the rest pose: the service answers why it cannot, and the arm goes on holding.
        at = {"position": {"x": 0.12, "y": 0.0, "z": 0.06}, "orientation": {"w": 1.0}}
        await client.change_scene(box("box", at=at, primitives=[{"type": 1, "dimensions": [0.1, 0.1, 0.1]}]))
        assert parking.server.has_logged("no way to the rest pose")
        answer = await client.call("/arm/park")
        assert not answer["success"]
        assert answer["message"].startswith("the arm is not parked: ")
        await client.until_mode("holding")
        # The request to park has stopped all else. After a stop the arm holds until something else is asked of it.
        assert (await client.call("/arm/enable"))["success"]
    parking.kill()
    assert parking.relaxed()
    assert not parking.rests()


@pytest.mark.parametrize("parking", [TWO_ARMS], indirect=True, ids=["two arms"])
def test_several_arms_go_to_rest_without_the_server(parking: Parked) -> None:
    """Each by its own way, once the ways of all are known to keep clear of each other."""
    parking.until_known(2)
    parking.kill()
    assert [parking.rests(arm) for arm in ("left", "right")] == [True, True], parking.text
