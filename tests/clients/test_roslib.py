"""roslibjs in two versions and the old roslibpy on the simulated arm, and the types for JavaScript."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from clients.js.generate_types import TARGET, generated
from harness.server import ROOT, RunningServer
from tests.clients.conftest import OF_DIALECT
from tests.helpers.programs import environment_with, heard_by, install_with_npm, run
from tests.test_readme import blocks

HERE = Path(__file__).parent
OLD = "roslibpy==1.8.1"

# Versions of the two libraries.
JAVASCRIPT, PYTHON = ("roslib1", "roslib2"), "roslibpy 1.8"

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]

JOINT_STATE = {"ros2": "sensor_msgs/msg/JointState", "ros1": "sensor_msgs/JointState"}

Heard = dict[str, Any]
Folders = pytest.TempPathFactory


@pytest.fixture(scope="module", params=["ros2", "ros1"])
def dialect(request: pytest.FixtureRequest) -> str:
    """Spelling for clients that take only a host and a port."""
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def server(dialect: str, request: pytest.FixtureRequest) -> RunningServer:
    running: RunningServer = request.getfixturevalue(OF_DIALECT[dialect])
    return running


@pytest.fixture(scope="module")
def node_modules(tmp_path_factory: Folders) -> Path:
    """A folder with both versions of roslib installed."""
    folder = tmp_path_factory.mktemp("roslib")
    for name in ("package.json", "roslib_scenario.mjs"):
        shutil.copy(HERE / name, folder)
    install_with_npm(folder)
    return folder


@pytest.fixture(scope="module")
def old_python(tmp_path_factory: Folders) -> Path:
    """An interpreter with the old version of roslibpy, which cannot live beside the new one."""
    return environment_with(sys.executable, tmp_path_factory.mktemp("roslibpy") / "venv", OLD)


@pytest.fixture(scope="module")
def heard(server: RunningServer, request: pytest.FixtureRequest) -> Callable[[str], Heard]:
    """Runs the scenario of a version, once; returns what it heard, step by step."""
    answers: dict[str, Heard] = {}

    def run(version: str) -> Heard:
        if version in JAVASCRIPT:
            folder: Path = request.getfixturevalue("node_modules")
            return heard_by("node", "roslib_scenario.mjs", version, f"ws://127.0.0.1:{server.port}", cwd=folder)
        return heard_by(request.getfixturevalue("old_python"), HERE / "roslibpy_scenario.py", str(server.port))

    def once(version: str) -> Heard:
        if version not in answers:
            answers[version] = run(version)
        return answers[version]

    return once


@pytest.fixture(scope="module", params=[*JAVASCRIPT, PYTHON])
def answers(request: pytest.FixtureRequest, heard: Callable[[str], Heard]) -> Heard:
    """What a version heard."""
    return heard(request.param)


@pytest.fixture(scope="module", params=JAVASCRIPT)
def of_javascript(request: pytest.FixtureRequest, heard: Callable[[str], Heard]) -> Heard:
    """What a version of roslibjs heard."""
    return heard(request.param)


def test_topics_and_services_are_listed(answers: Heard, dialect: str) -> None:
    topics = answers["topics"]["topics"] if isinstance(answers["topics"], dict) else answers["topics"]
    assert "/joint_states" in topics
    assert answers["topic type"] == JOINT_STATE[dialect]
    assert {"/rosapi/topics", "/rosapi/services"} <= set(answers["services"])


def test_topics_are_listed_with_their_types_and_a_message_type_is_explained(of_javascript: Heard, dialect: str) -> None:
    listed = of_javascript["topics"]
    types = dict(zip(listed["topics"], listed["types"], strict=True))
    assert types["/joint_states"] == JOINT_STATE[dialect]
    assert of_javascript["message details"][0]["fieldnames"] == ["header", "name", "position", "velocity", "effort"]


def test_a_topic_is_subscribed(answers: Heard, dialect: str) -> None:
    assert ("seq" in answers["joint states"]["header"]) is (dialect == "ros1")
    assert answers["joint states"]["name"] == JOINTS
    assert len(answers["joint states"]["position"]) == 6


@pytest.mark.parametrize("compression", ["png", "cbor"])
def test_a_topic_is_subscribed_compressed(of_javascript: Heard, compression: str) -> None:
    state = of_javascript[f"joint states as {compression}"]
    assert state["name"] == JOINTS
    assert len(state["position"]) == 6


def test_a_message_goes_to_another_client_and_a_goal_moves_the_arm(answers: Heard) -> None:
    assert answers["relayed"] == "hello"
    assert answers["goal"]["val"] == 1


def test_a_service_of_one_client_is_called_by_another_and_one_that_nobody_offers_fails(answers: Heard) -> None:
    assert answers["offered service"] == {"success": True, "message": "on"}
    assert "/nobody" in answers["unknown service"]


def test_the_values_of_a_service_that_failed_reach_its_caller(answers: Heard) -> None:
    if "failed service" not in answers:
        pytest.skip("roslibjs sends no values where a service has failed")
    assert answers["failed service"] == {"success": False, "message": "busy"}


def test_a_parameter_is_kept_and_one_that_is_not_there_is_read(answers: Heard) -> None:
    assert answers["parameter"] == 0.5
    assert answers["unknown parameter"] in (None, "failed: there is no parameter nobody_has_set_this")


@pytest.mark.parametrize("client", ["TFClient", "ROS2TFClient"])
def test_a_viewer_hears_where_a_link_is(of_javascript: Heard, client: str) -> None:
    if client not in of_javascript:
        pytest.skip("only roslib 2 has ROS2TFClient")
    transform = of_javascript[client]
    assert transform["translation"]["z"] > 0.05
    assert sum(value**2 for value in transform["rotation"].values()) == pytest.approx(1.0)


def test_the_robots_description_is_a_parameter_of_its_node(of_javascript: Heard) -> None:
    assert "<robot" in of_javascript["URDF of a node"]


def test_an_action_of_one_client_is_run_by_another(answers: Heard) -> None:
    assert answers["fibonacci"]["result"]["sequence"] == [0, 1, 1, 2, 3, 5, 8, 13]
    assert answers["fibonacci"]["feedback"]["sequence"] == [0, 1, 1]


TSC = ROOT / "server" / "page" / "node_modules" / ".bin" / "tsc"


def test_the_declarations_are_those_of_the_type_tables() -> None:
    assert TARGET.read_text() == generated(), "run .venv/bin/python -m clients.js.generate_types"


@pytest.mark.skipif(not TSC.exists() or shutil.which("npm") is None, reason="no TypeScript: make page installs it")
def test_the_program_of_the_readme_is_well_typed_with_roslib(tmp_path: Path) -> None:
    (program,) = blocks(TARGET.with_name("README.md"), "ts")
    (tmp_path / "program.ts").write_text(program)
    shutil.copy(TARGET, tmp_path)
    (tmp_path / "package.json").write_text('{"type":"module","dependencies":{"roslib":"2.1.0"}}')
    install_with_npm(tmp_path)
    options = ["--strict", "--noEmit", "--target", "es2022", "--module", "esnext", "--skipLibCheck"]
    options += ["--moduleResolution", "bundler"]
    for source, right in ((program, True), (program.replace("position[0]", "positions[0]"), False)):
        (tmp_path / "program.ts").write_text(source)
        done = run(TSC, *options, "program.ts", cwd=tmp_path)
        assert (done.returncode == 0) is right, done.stdout
