"""The ends of a server whose arm is to be parked, by the servos' log."""

import asyncio
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from harness.clients import ArmClient, arm_client
from harness.server import RunningServer, ServerOnBus, read_write_log, server_on_bus
from harness.waiting import TIMEOUT_S, wait_until
from robot.description.robot_folder import built_in
from tests.helpers.resources import runs
from tests.server.conftest import FAST, JOINTS

REST = built_in("so101").model.named_states["arm"]["rest"]

# A relaxed elbow sinks until its stop holds it.
SINK_RAD = 0.1


PARKS = {"ARM__ON_EXIT": "park", "ARM__ON_SERVER_LOST": "park"}


class Parked:
    """A server whose arm is to be parked, and the log of its servos."""

    def __init__(self, made: ServerOnBus, log: Path) -> None:
        self.server: RunningServer = made.server
        self.log = log

    @property
    def arm_pid(self) -> int:
        return int(re.findall(r"\(process (\d+), 100 Hz", self.text)[0])

    @property
    def text(self) -> str:
        return "\n".join(list(self.server.lines))

    def kill(self) -> None:
        """Kill the server, and wait for the end of its arm process."""
        pid = self.arm_pid
        self.server.process.kill()
        self.server.process.wait(TIMEOUT_S)
        wait_until(lambda: not runs(pid))

    def until_known(self, count: int = 1) -> None:
        """Wait until the arm process knows so many ways to the rest pose, one after the other."""
        wait_until(lambda: self.text.count("the way to the rest pose is known") >= count)

    @property
    def relaxed(self) -> bool:
        return set(read_write_log(self.log)[-1]["torque"].values()) == {0}

    @property
    def distance_to_rest(self) -> float:
        """Greatest distance of a joint from the rest pose at the servos' last write [rad]."""
        present = read_write_log(self.log)[-1]["present"]
        return max(
            abs(present[str(JOINTS[name].servo_id)] - JOINTS[name].ticks_from_rad(position)) * 2.0 * 3.1416 / 4096
            for name, position in REST.items()
        )

    @property
    def parked(self) -> bool:
        return self.relaxed and self.distance_to_rest < SINK_RAD

    @property
    def sunk(self) -> bool:
        """The arm was relaxed elsewhere."""
        return self.relaxed and self.distance_to_rest > 0.3


@contextmanager
def parked_server(folder: Path, **settings: str) -> Iterator[Parked]:
    log = folder / "writes.jsonl"
    level = {"SERVER__LOG_LEVEL": "debug"}
    with server_on_bus(EMULATOR__WRITE_LOG=str(log), **{**FAST, **PARKS, **level, **settings}) as made:
        yield Parked(made, log)


@pytest.fixture
def parking(tmp_path: Path) -> Iterator[Parked]:
    with parked_server(tmp_path) as parked:
        yield parked


async def begin_to_move(client: ArmClient) -> None:
    """Return on the way from where every joint is at 0."""
    await client.goal("/moveit_goal_joints", "sensor_msgs/JointState", {"name": ["shoulder_pan"], "position": [1.5]})
    await client.until("/joint_states", lambda states: states[-1]["position"][0] > 0.3)


def box(z_m: float, **fields: Any) -> dict[str, Any]:
    """A box of the planning scene in the way of the rest pose."""
    pose = {"position": {"x": 0.12, "y": 0.0, "z": z_m}, "orientation": {"w": 1.0}}
    shape = {"type": 1, "dimensions": [0.1, 0.1, 0.1]}
    return {
        "header": {"frame_id": "base_link"},
        "id": "box",
        "primitives": [shape],
        "primitive_poses": [pose],
        **fields,
    }


async def test_a_server_that_is_killed_in_mid_motion_leaves_a_parked_arm(parking: Parked) -> None:
    parking.until_known()
    async with arm_client(parking.server.url) as client:
        await begin_to_move(client)
        parking.kill()
    assert "goes back along its path" in parking.text
    assert parking.parked


async def test_a_scene_in_which_there_is_no_way_has_the_arm_relaxed_where_it_is(parking: Parked) -> None:
    parking.until_known()
    async with arm_client(parking.server.url) as client:
        await client.change_scene(box(0.06))
        assert parking.server.has_logged("no way to the rest pose")
    parking.kill()
    assert parking.sunk


async def test_an_orderly_end_parks_from_wherever_the_arm_comes_to_rest(parking: Parked) -> None:
    async with arm_client(parking.server.url) as client:
        await begin_to_move(client)
    assert parking.server.end(signal.SIGTERM)[0] == 0
    assert parking.parked


def test_a_second_signal_has_the_arm_relaxed_instead(parking: Parked) -> None:
    parking.until_known()
    pid = parking.arm_pid
    parking.server.process.send_signal(signal.SIGINT)
    assert parking.server.has_logged("the arm moves to its rest pose")
    parking.server.process.send_signal(signal.SIGINT)
    assert parking.server.process.wait(TIMEOUT_S) == 0
    wait_until(lambda: not runs(pid))
    assert "must not wait" in parking.text
    assert parking.relaxed


async def test_the_service_answers_why_it_cannot_and_the_arm_goes_on_holding(parking: Parked) -> None:
    async with arm_client(parking.server.url) as client:
        await client.change_scene(box(0.06))
        answer = await client.call("/arm/park")
        assert not answer["success"]
        assert answer["message"].startswith("the arm is not parked: ")
        await client.until_mode("holding")


async def test_a_stop_keeps_the_arm_from_being_relaxed(parking: Parked) -> None:
    async with arm_client(parking.server.url) as client:
        call = asyncio.create_task(client.call("/arm/park"))
        await client.until_mode("moving")
        async with arm_client(parking.server.url) as other:
            await other.call("/arm/stop")
        answer = await call
        assert not answer["success"]
        await client.until_mode("holding")


def test_several_arms_go_to_rest_without_the_server(tmp_path: Path) -> None:
    """Each by its own way, once the ways of all are known to keep clear of each other."""
    logs = {arm: tmp_path / f"{arm}.jsonl" for arm in ("left", "right")}
    feet = {"left": 0.25, "right": -0.25}
    config = tmp_path / "arms.toml"
    config.write_text(
        '[server]\nlog_level = "debug"\n'
        + "".join(
            f'[arms.{arm}]\non_server_lost = "park"\nbase_xyz_m = [0.0, {feet[arm]}, 0.0]\n'
            f'emulator.write_log = "{log}"\n'
            for arm, log in logs.items()
        )
    )
    with RunningServer(f"--port 0 --config {config}", FAST) as server:
        both = [Parked(ServerOnBus(server, None), log) for log in logs.values()]  # type: ignore[arg-type]
        both[0].until_known(2)
        pids = [int(pid) for pid in re.findall(r"process (\d+), 100 Hz", both[0].text)]
        assert len(pids) == 2
        server.process.kill()
        server.process.wait(TIMEOUT_S)
        for pid in pids:
            wait_until(lambda pid=pid: not runs(pid))
        assert [each.parked for each in both] == [True, True], both[0].text
