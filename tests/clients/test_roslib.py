"""roslibjs as it is published, versions 1 and 2, against the server with the simulated arm."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.server import RunningServer

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def node_modules(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both versions of roslib installed."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("roslib")
    for name in ("package.json", "roslib_scenario.mjs"):
        shutil.copy(HERE / name, folder)
    installed = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    if installed.returncode != 0:
        pytest.skip(f"npm cannot be reached: {installed.stderr.strip().splitlines()[-1]}")
    return folder


@pytest.fixture(scope="module", params=["roslib1", "roslib2"])
def answers(request: pytest.FixtureRequest, node_modules: Path, server: RunningServer) -> dict[str, Any]:
    """What the scenario heard, step by step."""
    done = subprocess.run(
        ["node", "roslib_scenario.mjs", request.param, f"ws://127.0.0.1:{server.port}"],
        cwd=node_modules,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr + done.stdout
    heard: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return heard


JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]


def test_topics_are_listed_with_their_types(answers: dict[str, Any]) -> None:
    listed = dict(zip(answers["topics"]["topics"], answers["topics"]["types"], strict=True))
    assert listed["/joint_states"] == "sensor_msgs/msg/JointState"
    assert answers["topic type"] == "sensor_msgs/msg/JointState"


def test_services_are_listed(answers: dict[str, Any]) -> None:
    assert {"/rosapi/topics", "/rosapi/services"} <= set(answers["services"])


def test_a_message_type_is_explained(answers: dict[str, Any]) -> None:
    main = answers["message details"][0]
    assert main["fieldnames"] == ["header", "name", "position", "velocity", "effort"]


def test_a_topic_is_subscribed(answers: dict[str, Any]) -> None:
    assert answers["joint states"]["name"] == JOINTS
    assert len(answers["joint states"]["position"]) == 6


@pytest.mark.parametrize("compression", ["png", "cbor"])
def test_a_topic_is_subscribed_compressed(answers: dict[str, Any], compression: str) -> None:
    state = answers[f"joint states as {compression}"]
    assert state["name"] == JOINTS
    assert len(state["position"]) == 6


def test_a_message_goes_from_one_client_to_another(answers: dict[str, Any]) -> None:
    assert answers["relayed"] == "hello"


def test_a_goal_moves_the_arm(answers: dict[str, Any]) -> None:
    assert answers["goal"]["val"] == 1


def test_a_service_of_one_client_is_called_by_another(answers: dict[str, Any]) -> None:
    assert answers["offered service"] == {"success": True, "message": "on"}


def test_a_service_that_nobody_offers_fails_with_its_name(answers: dict[str, Any]) -> None:
    assert "/nobody" in answers["unknown service"]


def test_a_parameter_is_kept(answers: dict[str, Any]) -> None:
    assert answers["parameter"] == 0.5


def test_an_action_of_one_client_is_run_by_another(answers: dict[str, Any]) -> None:
    assert answers["action"]["result"]["position"] == 0.5
    assert answers["action"]["result"]["reached_goal"] is True
    assert answers["action"]["feedback"]["position"] == 0.25


def test_the_action_of_the_examples_is_run(answers: dict[str, Any]) -> None:
    assert answers["fibonacci"]["result"]["sequence"] == [0, 1, 1, 2, 3, 5, 8, 13]
    assert answers["fibonacci"]["feedback"]["sequence"] == [0, 1, 1]


def test_a_parameter_that_is_not_there_is_read(answers: dict[str, Any]) -> None:
    assert answers["unknown parameter"] in (None, "failed: there is no parameter nobody_has_set_this")
