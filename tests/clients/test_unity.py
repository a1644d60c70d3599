"""clients/unity: its engine-free part moves the arm under Mono, and all of it compiles beside stand-ins for Unity."""

import json
import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Protocol
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.test_docs import rotation
from tests.test_readme import blocks

PACKAGE = ROOT / "clients" / "unity"
AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
NEWTONSOFT = Path("/usr/lib/cli/Newtonsoft.Json-5.0/Newtonsoft.Json.dll")

pytestmark = pytest.mark.skipif(
    shutil.which("mcs") is None or not NEWTONSOFT.exists(),
    reason="Mono is not installed: apt-get install mono-mcs libmono-system-net-http4.0-cil libnewtonsoft-json5.0-cil",
)


def compiled(target: str, output: Path, *sources: Path) -> Path:
    references = [f"-r:{NEWTONSOFT}", "-r:System.Xml.dll", "-r:System.dll"]
    # A field that only Unity's editor sets is never assigned: warning 0649.
    command = [
        "mcs",
        "-langversion:7.2",
        "-warnaserror",
        "-nowarn:0649",
        f"-target:{target}",
        f"-out:{output}",
        *references,
    ]
    done = subprocess.run(
        [*command, *map(str, sources)], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return output


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unity")
    shutil.copy(NEWTONSOFT, folder)
    core = sorted((PACKAGE / "Runtime" / "Core").glob("*.cs"))
    return compiled("exe", folder / "driver.exe", *core, PACKAGE / "Tests~" / "Driver.cs")


class Game:
    """The driver as a process: commands in, events out."""

    def __init__(self, driver: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            ["mono", str(driver), *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.seen: list[str] = []

    def give(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")

    def until(self, beginning: str) -> str:
        """Return the rest of the next line that begins so."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.seen.append(line)
            if line.startswith(beginning):
                return line.removeprefix(beginning).strip()
        raise AssertionError(f"no line begins with {beginning!r}: {self.seen}")


@pytest.fixture
def game(driver: Path) -> Iterator[Callable[..., Game]]:
    games: list[Game] = []

    def start(*arguments: str) -> Game:
        games.append(Game(driver, *arguments))
        return games[-1]

    yield start
    for each in games:
        each.process.kill()
        each.process.communicate(timeout=TIMEOUT_S)


def test_the_arm_is_moved_by_name_by_joint_by_tip_and_stopped(server: RunningServer, game: Callable[..., Game]) -> None:
    arm = game(f"ws://127.0.0.1:{server.port}")
    assert arm.until("report").startswith("connected to ws://127.0.0.1")
    arm.until("joints")
    # Unity: 10 cm to the right, 20 cm up, 25 cm ahead.
    goes_round(arm, tip="0.1 0.2 0.25", far="9 9 9", gripped="True the gripper is there")


class Driven(Protocol):
    """An arm that is moved by the lines of a driver: of Unity's, or of Unreal's."""

    def give(self, line: str) -> None: ...

    def until(self, beginning: str) -> str: ...


def goes_round(arm: Driven, *, tip: str, far: str, gripped: str) -> None:
    """Move an arm by name, joint, tip and gripper, to where it cannot go, and stop it midway."""
    arm.give("named ready")
    assert arm.until("goal") == "1 the arm is there"
    arm.give("joint shoulder_pan 0.5")
    assert arm.until("goal") == "1 the arm is there"
    arm.give(f"tip {tip}")
    assert arm.until("goal") == "1 the arm is there"
    arm.give("gripper 1.0")
    assert arm.until("gripper") == gripped
    arm.give(f"tip {far}")
    assert arm.until("goal").startswith("-31 ")
    arm.give("joint shoulder_pan -0.5")
    arm.give("stop")
    assert arm.until("goal").startswith("-7 ")


def test_a_named_goal_that_another_one_replaces_is_not_taken_for_the_end_of_the_latest(
    server: RunningServer, game: Callable[..., Game]
) -> None:
    arm = game(f"ws://127.0.0.1:{server.port}")
    arm.until("joints")
    arm.give("named ready")
    arm.give("named rest")
    assert arm.until("goal") == "1 the arm is there"


def test_a_goal_is_not_sent_without_a_connection_and_its_lost_answer_is_reported(game: Callable[..., Game]) -> None:
    with RunningServer() as lost:
        arm = game(f"ws://127.0.0.1:{lost.port}")
        arm.until("joints")
        arm.give("named ready")
        assert arm.until("sent") == "True"
        lost.process.kill()
        assert (
            arm.until("goal") == "-25 the connection was lost before the goal's end came; the arm may still be moving"
        )
    arm.give("named rest")
    assert arm.until("sent") == "False"


@pytest.fixture
def numbers(driver: Path) -> Callable[[str], list[str]]:
    def answers(*lines: str) -> list[str]:
        done = subprocess.run(
            ["mono", str(driver), "numbers"],
            input="\n".join(lines) + "\n",
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    return answers


def floats(line: str) -> np.ndarray:
    return np.array([float(word) for word in line.split()[1:]])


def test_coordinates_are_the_mirrored_axes(numbers: Callable[..., list[str]]) -> None:
    random = np.random.default_rng(0)
    for _ in range(3):
        position, quaternion = random.normal(size=3), random.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        p, q = (" ".join(map(str, numbers_)) for numbers_ in (position, quaternion))
        ros_p, unity_p, ros_q, unity_q = map(
            floats, numbers(f"position {p}", f"position_back {p}", f"rotation {q}", f"rotation_back {q}")
        )
        assert ros_p == pytest.approx(AXES @ position)
        assert unity_p == pytest.approx(AXES.T @ position)
        turned = np.asarray(rotation(list(quaternion)))
        assert np.asarray(rotation(list(ros_q))) == pytest.approx(AXES @ turned @ AXES.T, abs=1e-9)
        assert np.asarray(rotation(list(unity_q))) == pytest.approx(AXES.T @ turned @ AXES, abs=1e-9)


def test_a_connection_begins_with_messages_of_the_page_on_unreal(numbers: Callable[..., list[str]]) -> None:
    page = [json.loads(line) for block in blocks(ROOT / "docs" / "engines.md", "json") for line in block.splitlines()]
    frames = [json.loads(line.removeprefix("send ")) for line in numbers("setup")]
    assert len(frames) > 5
    assert [frame for frame in frames if frame not in page] == []


def test_delays_between_connections_double_up_to_ten_seconds(numbers: Callable[..., list[str]]) -> None:
    assert [line.split()[1] for line in numbers("delays")] == ["0.5", "1", "2", "4", "8", "10", "10"]


def test_the_arm_s_shapes_are_read_from_the_server(server: RunningServer, numbers: Callable[..., list[str]]) -> None:
    first, *visuals = numbers(f"robot http://127.0.0.1:{server.port}/robot/description.urdf")
    links, moving, count = map(int, first.split()[1:])
    urdf = ET.parse(ROOT / "robot" / "arms" / "so101" / "so101.urdf")
    assert (links, moving, count) == (len(urdf.findall("link")), 6, len(urdf.findall(".//visual")))
    assert "visual base_link Box 0.01834 0.11135 0.08742" in visuals
    assert "visual base_link Cylinder 0.04424 0.04424 0.02874" in visuals


MESHED = """<robot name="one"><link name="base"><visual><origin xyz="0 0 1"/><geometry>
  <mesh filename="package://one/part.stl" scale="0.001 0.001 0.001"/></geometry></visual></link></robot>"""


def test_meshes_come_from_the_server(tmp_path: Path, numbers: Callable[..., list[str]]) -> None:
    (tmp_path / "one.urdf").write_text(MESHED)
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "part.stl").write_bytes(stl(2))
    with serving(tmp_path) as port:
        assert numbers(f"robot http://127.0.0.1:{port}/one.urdf")[1:] == ["visual base Mesh 0.001 0.001 0.001 2"]


def stl(triangles: int) -> bytes:
    return bytes(80) + struct.pack("<I", triangles) + bytes(50 * triangles)


@contextmanager
def serving(folder: Path) -> Iterator[int]:
    """Serve the files of a folder over HTTP."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(folder))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


def test_a_cut_stl_or_a_text_stl_is_refused_with_its_sizes(tmp_path: Path, numbers: Callable[..., list[str]]) -> None:
    whole, cut, text = (tmp_path / name for name in ("whole.stl", "cut.stl", "text.stl"))
    whole.write_bytes(stl(2))
    cut.write_bytes(stl(2)[:-1])
    text.write_text("solid " + 40 * "facet normal 0 0 1\n")
    good, first, second = numbers(*(f"stl {path}" for path in (whole, cut, text)))
    assert good == "corners 18"
    assert first == "error no binary STL: 2 triangles need 184 bytes, the file has 183"
    assert re.fullmatch(r"error no binary STL: \d+ triangles need \d+ bytes, the file has 766", second)


def test_all_of_the_package_compiles_beside_stand_ins_for_unity(tmp_path: Path) -> None:
    sources = [path for part in ("Runtime", "Samples~") for path in sorted((PACKAGE / part).rglob("*.cs"))]
    compiled("library", tmp_path / "unity.dll", *sources, PACKAGE / "Tests~" / "StandIns.cs")
