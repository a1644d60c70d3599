"""A classroom as a teacher starts it, on real sockets: three servers, one host of planners, one Ctrl-C."""

import asyncio
import csv
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from websockets.asyncio.client import connect

from harness.clients import ArmClient, arm_client
from harness.server import FAST, ROOT
from harness.waiting import TIMEOUT_S
from server import cli

STUDENTS = 3


class Room:
    """A running classroom, its list and its processes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "server.cli", "classroom", "--students", str(STUDENTS), "--port", "0"]
        self.process = subprocess.Popen(
            [*command, "--data", str(folder), "--robot", "fetch"],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), **FAST},
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stderr is not None
        self.lines = []
        overdue = threading.Timer(TIMEOUT_S, self.process.kill)
        overdue.start()
        while not self.lines or "the classroom is ready" not in self.lines[-1]:
            self.lines.append(self.process.stderr.readline())
            assert self.lines[-1], "the classroom did not start:\n" + "".join(self.lines)
        overdue.cancel()

    @property
    def places(self) -> dict[str, tuple[str, str]]:
        """Address and token by name."""
        with (self.folder / "students.csv").open(newline="") as lines:
            return {row["name"]: (row["url"], row["token"]) for row in csv.DictReader(lines)}

    def url(self, name: str, token_of: str | None = None) -> str:
        return f"{self.places[name][0]}/?token={self.places[token_of or name][1]}"

    def server(self, name: str) -> psutil.Process:
        """The process that listens on a student's port."""
        port = int(self.places[name][0].rsplit(":", 1)[1])
        for child in psutil.Process(self.process.pid).children():
            if any(each.laddr.port == port and each.status == psutil.CONN_LISTEN for each in child.net_connections()):
                return child
        raise AssertionError(f"nobody listens on {port}")

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        self.process.send_signal(number)
        code = self.process.wait(TIMEOUT_S)
        if self.process.stderr is not None:
            self.process.stderr.close()
        return code


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    running = Room(tmp_path_factory.mktemp("room") / "class")
    yield running
    if running.process.poll() is None:
        running.end()


def workers(room: Room) -> list[psutil.Process]:
    """The processes that plan."""
    all_ = psutil.Process(room.process.pid).children(recursive=True)
    return [child for child in all_ if "planners.worker" in child.cmdline()]


async def answers(url: str) -> None:
    """Wait until a server takes connections."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            try:
                async with connect(url):
                    return
            except OSError:
                await asyncio.sleep(0.05)


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


def test_the_list_is_readable_by_the_teacher_alone(room: Room) -> None:
    assert stat.S_IMODE((room.folder / "students.csv").stat().st_mode) == 0o600


async def test_all_arms_move_at_the_same_time_on_the_same_planners(room: Room) -> None:
    assert len({worker.ppid() for worker in workers(room)}) == 1

    async def waves(name: str) -> list[int]:
        async with arm_client(room.url(name)) as client:
            return [await wave(client, y) for y in (0.3, -0.3)]

    codes = await asyncio.gather(*(waves(f"student{number:02d}") for number in range(1, STUDENTS + 1)))
    assert codes == [[1, 1]] * STUDENTS


async def test_the_teacher_can_stop_every_arm(room: Room) -> None:
    for name in ("student01", "student03"):
        async with arm_client(room.url(name, token_of="teacher")) as client:
            assert (await client.call("/arm/stop"))["success"]


async def test_a_server_that_dies_comes_back_and_nobody_else_notices(room: Room) -> None:
    async with arm_client(room.url("student01")) as other:
        neighbour = room.server("student01").pid
        room.server("student02").kill()
        assert await wave(other, 0.2) == 1
        await answers(room.url("student02"))
        assert room.server("student01").pid == neighbour
    async with arm_client(room.url("student02")) as back:
        await back.until_mode("holding")
        assert await wave(back, 0.2) == 1


def test_one_ctrl_c_ends_everything_and_the_tokens_stay_for_the_next_time(room: Room) -> None:
    before = room.places
    processes = psutil.Process(room.process.pid).children(recursive=True)
    assert len(processes) > 2 * STUDENTS
    assert room.end() == 0
    psutil.wait_procs(processes, timeout=TIMEOUT_S)
    assert not [process for process in processes if process.is_running()]
    again = Room(room.folder)
    try:
        assert {name: token for name, (_, token) in again.places.items()} == {
            name: token for name, (_, token) in before.items()
        }
    finally:
        assert again.end(signal.SIGTERM) == 0


def test_a_port_in_use_is_named_before_anything_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        options = ["--students", "2", "--port", str(port - 1), "--data", str(tmp_path / "class"), "--robot", "fetch"]
        assert cli.main(["classroom", *options]) != 0
    assert f"port {port}, for student02, cannot be taken" in capsys.readouterr().err
    assert not (tmp_path / "class").exists()
