"""A client in C, without any library, moves the simulated arm over raw TCP."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.server import FAST, ROOT, RunningServer

SOURCE = ROOT / "tests" / "helpers" / "raw_tcp_client.c"
TOKEN = "unreal-0123456789abcdef"
TIMEOUT_S = 180.0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client, compiled."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no compiler of C (cc) on this machine")
    program = tmp_path_factory.mktemp("raw_tcp") / "client"
    subprocess.run(
        [compiler, "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-o", str(program), str(SOURCE)],
        check=True,
        timeout=120,
    )
    return program


@pytest.fixture(scope="module", params=["", TOKEN], ids=["open", "with a token"])
def run(request: pytest.FixtureRequest, program: Path) -> Iterator[tuple[RunningServer, list[str]]]:
    """The server, and the lines that the client has printed."""
    settings = {**FAST, **({"ARMBRIDGE_ACCESS__OPERATE_TOKENS": f'{{"unreal": "{TOKEN}"}}'} if request.param else {})}
    with RunningServer("--port 0 --tcp-port 0", settings) as server:
        (port,) = re.findall(r"tcp://127\.0\.0\.1:(\d+) \(rosbridge over TCP\)", "\n".join(server.lines))
        command = [str(program), port, *([request.param] if request.param else [])]
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        assert done.returncode == 0, done.stderr
        yield server, done.stdout.splitlines()


Run = tuple[RunningServer, list[str]]


def test_joint_states_come_complete_in_the_spelling_of_ros_1(run: Run) -> None:
    _, lines = run
    begins = lines.index("topic text /joint_states")
    document = lines[begins : next((n for n in range(begins, len(lines)) if lines[n].startswith("document")), None)]
    kinds = dict(line.split(" ", 2)[:2] for line in document)
    assert {key: kinds.get(f"msg.header.{key}") for key in ("seq", "stamp.secs", "stamp.nsecs", "frame_id")} == {
        "seq": "int32",
        "stamp.secs": "int32",
        "stamp.nsecs": "int32",
        "frame_id": "text",
    }
    assert (kinds["msg.name.0"], kinds["msg.position.0"], kinds["msg.velocity.0"]) == ("text", "double", "double")
    assert kinds["msg.effort"] == "array"


def test_the_goal_is_carried_out(run: Run) -> None:
    _, lines = run
    assert "topic text /moveit_goal_result" in lines
    assert "msg.val int32 1" in lines


def test_the_call_is_answered_under_its_id(run: Run) -> None:
    _, lines = run
    begins = lines.index("op text service_response")
    assert lines[begins : begins + 6] == [
        "op text service_response",
        "service text /rosapi/topic_type",
        "values document",
        "values.type text sensor_msgs/JointState",
        "result boolean 1",
        "id text call_service:/rosapi/topic_type:5",
    ]


def test_the_log_names_the_client(run: Run) -> None:
    server, lines = run
    assert lines
    assert server.has_logged(" connected")
    assert server.has_logged(" left")
