"""clients/ros2: an ordinary ROS 2 node moves the arm through the bridge, on Fast DDS."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S, running
from tests.helpers import programs

PYTHON = ROOT / "build" / "ros2" / "bin" / "python"
SCENARIO_TIMEOUT_S = 300
# action_msgs/GoalStatus
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6

pytestmark = pytest.mark.skipif(
    not (ROOT / "build" / "ros2" / ".installed").exists(),
    reason="ROS 2 has no packages for this Python, or none are installed",
)

# A graph of its own, on this machine alone.
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(ROOT / "clients" / "ros2"),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
}


@pytest.fixture
def bridge(server: RunningServer) -> Iterator[subprocess.Popen[str]]:
    command = [str(PYTHON), "-m", "armbridge_ros2.bridge", "--ros-args", "-p", f"url:=ws://127.0.0.1:{server.port}"]
    with running(command, env=ENVIRONMENT) as process:
        yield process
        process.terminate()
        assert process.wait(TIMEOUT_S) == 0


def heard_by(scenario: str) -> dict[str, Any]:
    return programs.heard_by(PYTHON, Path(__file__).with_name(scenario), timeout_s=SCENARIO_TIMEOUT_S, env=ENVIRONMENT)


@pytest.mark.usefixtures("bridge")
def test_a_node_of_ros_2_sees_the_arm_moves_it_and_stops_it() -> None:
    seen = heard_by("ros2_scenario.py")
    assert seen["ends"][:2] == 2 * [["1", "the arm is there"]]
    assert seen["ends"][2][0] == "-7"
    assert seen["shoulder_pan"] == pytest.approx(0.5, abs=0.02)
    assert "<robot" in seen["urdf"] or seen["urdf"].startswith("<?xml")
    assert seen["stop"][0] is True


@pytest.mark.skipif(
    not (ROOT / "build" / "ros2" / "share" / "moveit_msgs").exists(),
    reason="the packages of actions are not on PyPI: make test-ros2 compiles them",
)
@pytest.mark.usefixtures("bridge")
def test_action_clients_of_ros_2_get_feedback_results_and_cancel() -> None:
    seen = heard_by("ros2_actions_scenario.py")
    assert seen["followed"] == [SUCCEEDED, 0, True]
    assert seen["cancelled"] == CANCELED
    assert seen["stopped"][0] == ABORTED
    assert "/trajectory_execution_event" in seen["stopped"][1]
    assert seen["refused"][0] == ABORTED
    assert "shoulder_pan" in seen["refused"][1]
    assert seen["gripper"] == [SUCCEEDED, True, 1.0]
    assert seen["moved"] == [SUCCEEDED, 1, True]
    assert seen["pose"] == [1, "base_link"]
    assert seen["too many"][0] == 99999
    assert "fk_link_names" in seen["too many"][1]
    assert seen["in contact"] == [ABORTED, -10]
