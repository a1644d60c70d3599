"""roslibpy as it is published, versions 1.8 and 2, against the server with the simulated arm."""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.clients import heard_by
from tests.helpers.server import RunningServer

SCENARIO = Path(__file__).with_name("roslibpy_scenario.py")
OLD = "roslibpy==1.8.1"


def old_python(folder: Path) -> str:
    """An interpreter with the old version, which cannot live beside the new one."""
    venv.create(folder, with_pip=True)
    python = str(folder / "bin" / "python")
    installed = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", OLD], capture_output=True, text=True, timeout=300, check=False
    )
    if installed.returncode != 0:
        pytest.skip(f"PyPI cannot be reached: {installed.stderr.strip().splitlines()[-1]}")
    return python


@pytest.fixture(scope="module", params=["1.8", "2"])
def answers(
    request: pytest.FixtureRequest, server: RunningServer, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    """What the scenario heard, step by step."""
    python = sys.executable if request.param == "2" else old_python(tmp_path_factory.mktemp("venv"))
    return heard_by(python, SCENARIO, str(server.port))


def test_topics_and_services_are_listed(answers: dict[str, Any]) -> None:
    topics = answers["topics"]["topics"] if isinstance(answers["topics"], dict) else answers["topics"]
    assert "/joint_states" in topics
    assert answers["topic type"] == "sensor_msgs/msg/JointState"
    assert "/rosapi/topics" in answers["services"]


def test_a_topic_is_subscribed(answers: dict[str, Any]) -> None:
    assert len(answers["joint states"]["position"]) == 6


def test_a_message_goes_from_one_client_to_another(answers: dict[str, Any]) -> None:
    assert answers["relayed"] == "hello"


def test_a_service_of_one_client_is_called_by_another(answers: dict[str, Any]) -> None:
    assert answers["offered service"] == {"success": True, "message": "on"}


def test_a_service_that_nobody_offers_fails_with_its_name(answers: dict[str, Any]) -> None:
    assert "/nobody" in answers["unknown service"]


def test_a_goal_moves_the_arm(answers: dict[str, Any]) -> None:
    assert answers["goal"]["val"] == 1


def test_an_action_of_one_client_is_run_by_another(answers: dict[str, Any]) -> None:
    assert answers["action"]["result"]["position"] == 0.5
    assert answers["action"]["feedback"]["position"] == 0.25


def test_a_parameter_is_kept(answers: dict[str, Any]) -> None:
    assert answers["parameter"] == 0.5


def test_the_action_of_the_examples_is_run(answers: dict[str, Any]) -> None:
    assert answers["fibonacci"]["result"]["sequence"] == [0, 1, 1, 2, 3, 5, 8, 13]
    assert answers["fibonacci"]["feedback"]["sequence"] == [0, 1, 1]


def test_the_action_of_the_examples_of_ros2_is_run(answers: dict[str, Any]) -> None:
    if "fibonacci of ROS 2" not in answers:
        pytest.skip("roslibpy 1 has no actions of ROS 2")
    assert answers["fibonacci of ROS 2"]["result"]["sequence"] == [0, 1, 1, 2, 3, 5, 8, 13]
    assert answers["fibonacci of ROS 2"]["feedback"]["sequence"] == [0, 1, 1]


def test_a_parameter_that_is_not_there_is_read(answers: dict[str, Any]) -> None:
    assert not answers["unknown parameter"]
