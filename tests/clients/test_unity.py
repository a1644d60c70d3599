"""clients/unity: its engine-free part moves the arm under Mono, and all of it compiles beside stand-ins for Unity."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.clients.engines import (
    Answers,
    connects_as_documented,
    floats,
    goes_round,
    refuses_a_cut_stl,
    stl,
    turns_coordinates,
)
from tests.helpers.programs import run

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
    options = ["-langversion:7.2", "-warnaserror", "-nowarn:0649", f"-target:{target}", f"-out:{output}"]
    command = ["mcs", *options, *references, *map(str, sources)]
    done = run(*command)
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
def numbers(driver: Path) -> Answers:
    def answers(*lines: str) -> list[str]:
        text, command = "\n".join(lines) + "\n", ["mono", str(driver), "numbers"]
        done = run(*command, input=text)
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    return answers


def test_coordinates_are_the_mirrored_axes(numbers: Answers) -> None:
    turns_coordinates(numbers, AXES, 1.0)
    (back,) = map(floats, numbers("rotation_back 0.1 0.3 0.3 0.9"))
    (there,) = map(floats, numbers(f"rotation {' '.join(map(str, back))}"))
    assert there == pytest.approx((0.1, 0.3, 0.3, 0.9), abs=1e-9)


def test_a_connection_begins_with_messages_of_the_page_on_unreal_and_is_tried_again(numbers: Answers) -> None:
    connects_as_documented(numbers)


def test_the_arm_s_shapes_are_read_from_the_server(server: RunningServer, numbers: Answers) -> None:
    first, *visuals = numbers(f"robot http://127.0.0.1:{server.port}/robot/description.urdf")
    links, moving, count = map(int, first.split()[1:])
    urdf = ET.parse(ROOT / "robot" / "arms" / "so101" / "so101.urdf")
    assert (links, moving, count) == (len(urdf.findall("link")), 6, len(urdf.findall(".//visual")))
    assert "visual base_link Box 0.01834 0.11135 0.08742" in visuals
    assert "visual base_link Cylinder 0.04424 0.04424 0.02874" in visuals


MESHED = """<robot name="one"><link name="base"><visual><origin xyz="0 0 1"/><geometry>
  <mesh filename="package://one/part.stl" scale="0.001 0.001 0.001"/></geometry></visual></link></robot>"""


def test_meshes_come_from_the_server(tmp_path: Path, numbers: Answers) -> None:
    (tmp_path / "one.urdf").write_text(MESHED)
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "part.stl").write_bytes(stl(2))
    with serving(tmp_path) as port:
        assert numbers(f"robot http://127.0.0.1:{port}/one.urdf")[1:] == ["visual base Mesh 0.001 0.001 0.001 2"]


@contextmanager
def serving(folder: Path) -> Iterator[int]:
    """Serve the files of a folder over HTTP."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(folder))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


def test_a_cut_stl_or_a_text_stl_is_refused_with_its_sizes(tmp_path: Path, numbers: Answers) -> None:
    text = b"solid " + 40 * b"facet normal 0 0 1\n"
    count = int.from_bytes(text[80:84], "little")
    reason = f"error no binary STL: {count} triangles need {84 + 50 * count} bytes, the file has 766"
    refuses_a_cut_stl(numbers, tmp_path, text, reason)


def test_all_of_the_package_compiles_beside_stand_ins_for_unity(tmp_path: Path) -> None:
    sources = [path for part in ("Runtime", "Samples~") for path in sorted((PACKAGE / part).rglob("*.cs"))]
    compiled("library", tmp_path / "unity.dll", *sources, PACKAGE / "Tests~" / "StandIns.cs")
