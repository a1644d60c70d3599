"""A classroom as a teacher starts it, on real sockets: three servers, one host of planners, one Ctrl-C."""

import asyncio
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from harness.clients import ArmClient, arm_client
from harness.waiting import TIMEOUT_S, until
from server import cli
from tests.helpers.classroom import Room
from tests.helpers.resources import is_open

STUDENTS = 3


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    running = Room(tmp_path_factory.mktemp("room") / "class", STUDENTS, "--robot", "fetch")
    yield running
    if running.process.poll() is None:
        running.end()


async def wave(client: ArmClient, y: float) -> int:
    """Send the arm's hand to a point beside its middle [m]; returns the error code."""
    constraint = {
        "header": {"frame_id": "base_link"},
        "link_name": "gripper_link",
        "constraint_region": {
            "primitives": [{"type": 2, "dimensions": [0.01]}],
            "primitive_poses": [{"position": {"x": 0.6, "y": y, "z": 1.0}, "orientation": {"w": 1.0}}],
        },
    }
    request = {"group_name": "arm", "goal_constraints": [{"position_constraints": [constraint]}]}
    goal_id = await client.send_goal("/move_action", "moveit_msgs/action/MoveGroup", {"request": request})
    code: int = (await client.result(goal_id))["values"]["error_code"]["val"]
    return code


async def test_all_arms_move_at_the_same_time_on_the_same_planners_and_the_teacher_can_stop_each(room: Room) -> None:
    processes = psutil.Process(room.process.pid).children(recursive=True)
    planners = {each.pid: each.ppid() for each in processes if "planners.worker" in each.cmdline()}
    # All are copies of one.
    assert len(set(planners.values()) & planners.keys()) == 1
    assert len(set(planners.values()) - planners.keys()) == 1

    async def waves(name: str) -> list[int]:
        async with arm_client(room.url(name)) as client:
            return [await wave(client, y) for y in (0.3, -0.3)]

    names = [f"student{number:02d}" for number in range(1, STUDENTS + 1)]
    assert await asyncio.gather(*map(waves, names)) == [[1, 1]] * STUDENTS
    for name in names:
        async with arm_client(room.url(name, token_of="teacher")) as client:
            assert (await client.call("/arm/stop"))["success"]
    # The tokens are for the teacher alone.
    assert stat.S_IMODE((room.folder / "students.csv").stat().st_mode) == 0o600


async def test_a_server_that_dies_comes_back_and_nobody_else_notices(room: Room) -> None:
    async with arm_client(room.url("student01")) as other:
        neighbour, dies = room.server("student01"), room.server("student02")
        dies.kill()
        assert await wave(other, 0.2) == 1
        await until(lambda: is_open(room.port("student02")))
        assert room.server("student01") == neighbour
    async with arm_client(room.url("student02")) as back:
        await back.until_mode("holding")
        assert await wave(back, 0.2) == 1


def test_one_ctrl_c_ends_everything(room: Room) -> None:
    processes = psutil.Process(room.process.pid).children(recursive=True)
    assert len(processes) > 2 * STUDENTS
    assert room.end() == 0
    psutil.wait_procs(processes, timeout=TIMEOUT_S)
    assert not [process for process in processes if process.is_running()]


def test_a_port_in_use_is_named_before_anything_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        options = ["--students", "2", "--port", str(port - 1), "--data", str(tmp_path / "class"), "--robot", "fetch"]
        assert cli.main(["classroom", *options]) != 0
    assert f"port {port}, for student02, cannot be taken" in capsys.readouterr().err
    assert not (tmp_path / "class").exists()
