"""Commands at a terminal."""

import asyncio
import io
import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from harness.clients import ArmClient, arm_client
from harness.server import RunningServer, free_port, read_write_log
from harness.waiting import TIMEOUT_S, running, until
from planners.shared_pool import LONGEST_PLANNING_S
from robot.calibration import save
from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.classroom import Room
from tests.helpers.programs import run
from tests.helpers.resources import is_open
from tests.helpers.robots import nominal_calibration
from tests.server.commands.conftest import Run

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
    goal = {"position_constraints": [constraint]}
    # The longest that a classroom allows: a planner may get its turn late.
    request = {"group_name": "arm", "goal_constraints": [goal], "allowed_planning_time": LONGEST_PLANNING_S}
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
        await asyncio.to_thread(dies.wait, TIMEOUT_S)
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


def test_ctrl_c_ends_a_replay_that_still_reads_its_file(tmp_path: Path) -> None:
    pipe = tmp_path / "endless.mcap"
    os.mkfifo(pipe)
    command = [sys.executable, "-m", "server.cli", "replay", str(pipe), "--port", "0"]
    with running(command, stderr=subprocess.DEVNULL) as replay, pipe.open("wb"):
        replay.send_signal(signal.SIGINT)
        assert replay.wait(TIMEOUT_S) == ExitCode.FAILED


TOKENS = {name: f"{name}-0123456789abcdef" for name in ("own", "admin", "filed", "variable")}


def members(file: Path | io.BytesIO) -> dict[str, str]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings with secrets wherever there can be some; nobody listens at their port."""
    tokens = tmp_path / "tokens.toml"
    tokens.write_text(f'view_tokens = {{ screen = "{TOKENS["filed"]}" }}\n')
    tokens.chmod(0o600)
    config = tmp_path / "armbridge.toml"
    config.write_text(
        f'[server]\nport = {free_port()}\n[access]\ntoken = "{TOKENS["own"]}"\ntoken_file = "{tokens}"\n'
        f'admin_tokens = {{ boss = "{TOKENS["admin"]}" }}\n'
        '[zenoh]\nconnect = ["tls/h:1#connect_private_key_base64=SECRETKEY"]\n'
    )
    monkeypatch.setenv("ARMBRIDGE_ACCESS__OPERATE_TOKENS", json.dumps({"desk": TOKENS["variable"]}))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("HOME", str(tmp_path))
    return config


def test_no_token_or_password_of_the_settings_is_in_any_member(file: Path, tmp_path: Path) -> None:
    faults = tmp_path / "data" / "armbridge" / "faults"
    faults.mkdir(parents=True)
    (faults / "fault-1.jsonl").write_text(" ".join(TOKENS.values()))
    output = tmp_path / "report.zip"
    serial = "socket://ada:hunter2@127.0.0.1:9"
    assert cli.main(["report", "--config", str(file), "--output", str(output), "--serial", serial]) == ExitCode.DONE
    told = members(output)
    assert {"settings.json", "versions.json", "arm/robot.toml", "faults/fault-1.jsonl"} <= told.keys()
    for name, text in told.items():
        for secret in ("0123456789abcdef", "SECRETKEY", "hunter2", str(tmp_path)):
            assert secret not in text, name


def test_on_a_machine_where_nothing_runs_there_is_a_report_of_what_there_is(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["report", "--config", str(file)]) == ExitCode.DONE
    (output,) = tmp_path.glob("armbridge-report-*.zip")
    said = capsys.readouterr()
    assert f"written to {output.name}" in said.out
    told = members(output)
    assert all(f"{name} (" in said.err for name in told)
    assert "none answers at 127.0.0.1:" in told["problems.txt"]
    assert "no port is named" in told["problems.txt"]
    assert stat.S_IMODE(output.stat().st_mode) == 0o600


def test_settings_that_are_refused_are_reported_and_a_file_that_is_there_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "report.zip"
    assert cli.main(["report", "--output", str(output), "--set", "goals.capacity=0"]) == ExitCode.DONE
    told = members(output)
    assert "settings: goals.capacity: " in told["problems.txt"]
    assert json.loads(told["settings.json"])["settings"]["goals"]["capacity"] == 16
    assert cli.main(["report", "--output", str(output)]) == ExitCode.FAILED
    assert "--output" in capsys.readouterr().err
    assert members(output) == told


def test_without_a_server_servos_are_only_read(armbridge: Run, file: Path, tmp_path: Path, write_log: Path) -> None:
    output, calibration = tmp_path / "report.zip", tmp_path / "arm.json"
    save(nominal_calibration(), calibration)
    options = "--config", str(file), "--output", str(output), "--calibration", str(calibration)
    assert armbridge("report", *options).returncode == ExitCode.DONE
    told = members(output)
    registers = json.loads(told["bus/registers.json"])
    assert list(registers) == ["1", "2", "3", "4", "5", "6"]
    assert registers["3"]["MODEL_NUMBER"] == 777
    assert registers["3"]["ID"] == 3
    checks = {finding["check"]: finding["verdict"] for finding in json.loads(told["bus/doctor.json"])}
    assert checks["servos"] == checks["calibration"] == "good"
    assert json.loads(told["arm/calibration.json"])["elbow_flex"]["id"] == 3
    assert read_write_log(write_log) == []


TOKEN = "only-the-admin-knows-it"


def verify(url: str, typed: str) -> subprocess.CompletedProcess[str]:
    return run(sys.executable, "-m", "server.cli", "verify", "--url", url, input=typed)


def test_a_person_at_a_terminal_compares_the_arm_pose_by_pose(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunningServer("--port 0 --rate 5", {"ARMBRIDGE_ACCESS__TOKEN": TOKEN}) as server:
        without_token = cli.main(["verify", "--url", server.url])
        assert (without_token, capsys.readouterr().err[:11]) == (ExitCode.FAILED, "armbridge: ")
        monkeypatch.setenv("ARMBRIDGE_TOKEN", TOKEN)
        # Input that ends cancels the procedure.
        assert verify(server.url, "").returncode == ExitCode.FAILED
        assert server.has_logged("verify ended early: cancelled")
        # Move; yes at three poses; the gripper does not look as the model.
        answer = verify(server.url, "\ny\ny\ny\nno\ngripper\n")
    assert answer.returncode == ExitCode.PROBLEMS, answer.stderr
    assert "deg from its goal" in answer.stderr
    droops_deg = [float(each) for each in re.findall(r"^\w+ +(\d+\.\d)$", answer.stderr, re.MULTILINE)]
    assert droops_deg
    assert max(droops_deg) < 3.5
    assert "* gripper looks otherwise than the model" in answer.stdout
    assert "compared in 4 poses" in answer.stdout


def test_a_missing_server_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["verify", "--url", f"ws://127.0.0.1:{free_port()}"]) == ExitCode.FAILED
    assert "is armbridge serve running there?" in capsys.readouterr().err
