"""compas_fab as it is published, as a ROS 1 and as a ROS 2 client, against the server with the simulated arm.

It is large and wants an environment of its own: ``make test-clients`` makes it and runs this.
"""

from pathlib import Path
from typing import Any

import pytest

from harness.server import RunningServer
from tests.helpers.programs import heard_by
from tests.helpers.robots import so101

SCENARIO = Path(__file__).with_name("compas_fab_scenario.py")
PYTHON = Path(__file__).parents[2] / "build" / "compas_fab" / "bin" / "python"

pytestmark = pytest.mark.skipif(not PYTHON.exists(), reason="compas_fab is not installed: make test-clients does it")

MESHES = SCENARIO.with_name("compas_fab_meshes_scenario.py")

MESH_LINK = '<link name="sign"><visual><geometry><mesh filename="assets/sign.obj"/></geometry></visual></link>'
MESH_JOINT = '<joint name="sign" type="fixed"><parent link="base_link"/><child link="sign"/></joint>'
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"

QUERIES = {"ros1": "?ros=1", "ros2": ""}


@pytest.fixture(scope="module", params=QUERIES)
def dialect(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def answers(dialect: str, server: RunningServer) -> dict[str, Any]:
    """What the scenario heard, step by step."""
    return heard_by(PYTHON, SCENARIO, f"ws://127.0.0.1:{server.port}/{QUERIES[dialect]}")


def test_the_robot_is_loaded_and_its_kinematics_agree(answers: dict[str, Any], dialect: str) -> None:
    assert answers["distro"] == {"ros1": "noetic", "ros2": "jazzy"}[dialect]
    assert answers["robot"] == "so101"
    assert len(answers["group joints"]) == 5
    assert answers["inverse kinematics"]["elbow_flex"] == pytest.approx(0.9, abs=0.02)


def test_a_motion_and_a_line_end_where_they_were_to(answers: dict[str, Any]) -> None:
    assert answers["planned"]["fraction"] == 1.0
    assert answers["planned end"]["shoulder_pan"] == pytest.approx(0.6, abs=2e-3)
    assert answers["line"]["fraction"] == pytest.approx(1.0)
    assert answers["line"]["points"] > 2


def test_a_mesh_comes_collides_is_held_and_goes(answers: dict[str, Any]) -> None:
    assert answers["scene with the box"] == ["box"]
    assert answers["scene without the box"] == []
    assert any("box" in pair for pair in answers["collision"])
    assert answers["held"] == ["box"]
    assert answers["planned with the box"] == 1.0


def test_both_actions_execute(answers: dict[str, Any], dialect: str) -> None:
    if dialect == "ros2":
        pytest.skip("compas_fab's ROS 2 client does not hear of the end of an action")
    assert answers["executed"] == "done"
    assert answers["followed"] == "done"


def test_meshes_come_over_http_from_the_port_of_rosbridge(tmp_path: Path) -> None:
    robot = so101()
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "sign.obj").write_text(TRIANGLE)
    (tmp_path / "arm.urdf").write_text(robot.urdf.replace("</robot>", f"{MESH_LINK}{MESH_JOINT}</robot>"))
    (tmp_path / "arm.srdf").write_text(robot.srdf)
    files = f"--urdf {tmp_path / 'arm.urdf'} --srdf {tmp_path / 'arm.srdf'}"
    with RunningServer(arguments=f"--port 0 {files}") as server:
        heard = heard_by(PYTHON, MESHES, "127.0.0.1", str(server.port))
    assert heard == {"package://so101_description/assets/sign.obj": [3]}
