"""A client in C, without any library, moves the simulated arm over raw TCP."""

import re
import shutil
from pathlib import Path

import pytest

from harness.server import FAST, ROOT, RunningServer
from tests.helpers.programs import run

SOURCE = ROOT / "tests" / "helpers" / "raw_tcp_client.c"
TOKEN = "unreal-0123456789abcdef"

# What each kind of field in a joint state in ROS 1's spelling is printed as.
JOINT_STATE = {
    "msg.header.seq": "int32",
    "msg.header.stamp.secs": "int32",
    "msg.header.stamp.nsecs": "int32",
    "msg.header.frame_id": "text",
    "msg.name.0": "text",
    "msg.position.0": "double",
    "msg.velocity.0": "double",
    "msg.effort": "array",
}
ANSWER = """op text service_response
service text /rosapi/topic_type
values document
values.type text sensor_msgs/JointState
result boolean 1
id text call_service:/rosapi/topic_type:5
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client, compiled."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no compiler of C (cc) on this machine")
    program = tmp_path_factory.mktemp("raw_tcp") / "client"
    done = run(compiler, "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-o", program, SOURCE)
    assert done.returncode == 0, done.stderr
    return program


def test_a_client_hears_joint_states_reaches_a_goal_and_calls_a_service(program: Path) -> None:
    tokens = {"ARMBRIDGE_ACCESS__OPERATE_TOKENS__UNREAL": TOKEN}
    with RunningServer("--port 0 --tcp-port 0", {**FAST, **tokens}) as server:
        (port,) = re.findall(r"tcp://127\.0\.0\.1:(\d+) \(rosbridge over TCP\)", "\n".join(server.lines))
        done = run(program, port, TOKEN)
        assert done.returncode == 0, done.stderr
        assert server.has_logged(" connected")
        assert server.has_logged(" left")
    state = done.stdout.split("topic text /joint_states\n")[1].split("\ndocument")[0]
    kinds = dict(line.split(" ", 2)[:2] for line in state.splitlines())
    assert {key: kinds.get(key) for key in JOINT_STATE} == JOINT_STATE
    assert "msg.val int32 1\n" in done.stdout.split("topic text /moveit_goal_result\n")[1]
    assert ANSWER in done.stdout
