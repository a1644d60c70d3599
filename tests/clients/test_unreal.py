"""clients/unreal: its engine-free part moves the arm, and all of it compiles beside stand-ins for Unreal."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.clients.test_unity import floats, goes_round, stl
from tests.test_docs import rotation
from tests.test_readme import blocks

PLUGIN = ROOT / "clients" / "unreal" / "Armbridge"
MODULE = PLUGIN / "Source" / "Armbridge"
TESTS = ROOT / "clients" / "unreal" / "Tests"
AXES = np.diag([1.0, -1.0, 1.0])
# Unreal builds modules without exceptions and run-time types.
COMPILE = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fno-rtti"]
COMPILE_TIMEOUT_S = 300

pytestmark = pytest.mark.skipif(
    shutil.which("g++") is None or not Path("/usr/include/rapidjson").exists(),
    reason="no C++ compiler, or no RapidJSON: apt-get install g++ rapidjson-dev",
)


def compiled(*arguments: str) -> None:
    done = subprocess.run(
        [*COMPILE, *arguments], capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("unreal") / "driver"
    core = MODULE / "Private" / "Core"
    compiled("-I", str(core), *map(str, sorted(core.glob("*.cpp"))), str(TESTS / "Driver.cpp"), "-o", str(program))
    return program


class Game:
    """The driver as a process, with its frames taken to a server and back."""

    def __init__(self, driver: Path, socket: ClientConnection) -> None:
        self.socket = socket
        self.process = subprocess.Popen(
            [str(driver)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.give("setup")

    def ask(self, line: str) -> list[str]:
        """Give the driver a line, and return its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(line + "\n")
        return list(iter(lambda: self.process.stdout.readline().rstrip("\n"), "end"))  # type: ignore[union-attr]

    def give(self, line: str) -> None:
        """Give a command, and send the frames that it makes."""
        for answer in self.ask(line):
            assert answer.startswith("send "), answer
            self.socket.send(answer.removeprefix("send "))

    def until(self, beginning: str) -> str:
        """Take frames until there is an event that begins so; return its rest."""
        while True:
            for event in self.ask("frame " + str(self.socket.recv(timeout=TIMEOUT_S))):
                if event.startswith(beginning):
                    return event.removeprefix(beginning).strip()


@pytest.fixture
def arm(driver: Path, server: RunningServer) -> Iterator[Game]:
    with connect(f"ws://127.0.0.1:{server.port}") as socket:
        game = Game(driver, socket)
        yield game
        game.process.communicate(timeout=TIMEOUT_S)


def test_the_arm_is_moved_by_name_by_joint_by_tip_and_stopped(arm: Game) -> None:
    assert "shoulder_pan" in arm.until("joints")
    # Unreal: 25 cm ahead, 10 cm to the right, 20 cm up.
    goes_round(arm, tip="25 10 20", far="900 900 900", gripped="1 the gripper is there")


def test_a_named_goal_that_another_one_replaces_is_not_taken_for_the_end_of_the_latest(arm: Game) -> None:
    arm.give("named ready")
    arm.give("named rest")
    assert arm.until("goal") == "1 the arm is there"


@pytest.fixture
def answers(driver: Path) -> Callable[..., list[str]]:
    def of(*lines: str) -> list[str]:
        text = "\n".join(lines) + "\n"
        done = subprocess.run([str(driver)], input=text, capture_output=True, text=True, timeout=TIMEOUT_S, check=True)
        return [line for line in done.stdout.splitlines() if line != "end"]

    return of


def test_a_lost_connection_ends_what_was_asked_once(answers: Callable[..., list[str]]) -> None:
    lost = "-25 the connection was lost before the goal's end came; the arm may still be moving"
    assert answers("named ready", "gripper 1", "lose", "lose")[2:] == [
        f"goal {lost}",
        "gripper 0 the connection was lost before the gripper's end came",
    ]


def test_frames_that_are_no_json_or_of_another_shape_have_no_events(answers: Callable[..., list[str]]) -> None:
    frames = [
        "{",
        "[1]",
        '{"op":1}',
        '{"op":"publish","topic":"/joint_states","msg":{"name":["a"],"position":[]}}',
        '{"op":"publish","topic":"/moveit_goal_status","msg":{"values":[1,{"key":2}]}}',
        '{"op":"publish","topic":"/moveit_goal_status","msg":null}',
        '{"op":"action_result","id":"other","values":{}}',
        "[" * 100_000,
    ]
    assert answers(*(f"frame {frame}" for frame in frames)) == []


def test_a_goal_that_is_no_number_is_not_made(answers: Callable[..., list[str]]) -> None:
    assert answers("joint shoulder_pan nan", "tip nan 0 0", "gripper nan", "lose") == [
        "error the position of shoulder_pan is no number",
        "error the pose of the tip holds what is no number",
        "error the gripper's position or effort is no number",
    ]


def test_a_connection_begins_with_messages_of_the_page(answers: Callable[..., list[str]]) -> None:
    page = [json.loads(line) for block in blocks(ROOT / "docs" / "engines.md", "json") for line in block.splitlines()]
    frames = [json.loads(line.removeprefix("send ")) for line in answers("setup")]
    assert len(frames) > 5
    assert [frame for frame in frames if frame not in page] == []


def test_a_token_is_the_first_frame(answers: Callable[..., list[str]]) -> None:
    assert answers('setup "secret')[0] == 'send {"op":"auth","token":"\\"secret"}'


def test_coordinates_are_the_mirrored_axes(answers: Callable[..., list[str]]) -> None:
    random = np.random.default_rng(0)
    position, quaternion = random.normal(size=3), random.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    p, q = (" ".join(map(str, each)) for each in (position, quaternion))
    ros_p, unreal_p, mirrored = map(floats, answers(f"position {p}", f"position_back {p}", f"rotation {q}"))
    assert ros_p == pytest.approx(AXES @ position / 100)
    assert unreal_p == pytest.approx(AXES @ position * 100)
    turned = np.asarray(rotation(list(quaternion)))
    assert np.asarray(rotation(list(mirrored))) == pytest.approx(AXES @ turned @ AXES, abs=1e-9)


def test_delays_between_connections_double_up_to_ten_seconds(answers: Callable[..., list[str]]) -> None:
    assert [line.split()[1] for line in answers("delays")] == ["0.5", "1", "2", "4", "8", "10", "10"]


def test_an_stl_that_is_cut_off_is_refused_with_its_sizes(tmp_path: Path, answers: Callable[..., list[str]]) -> None:
    whole, cut, none = (tmp_path / name for name in ("whole.stl", "cut.stl", "none.stl"))
    whole.write_bytes(stl(2))
    cut.write_bytes(stl(2)[:-1])
    none.write_bytes(b"")
    assert answers(*(f"stl {path}" for path in (whole, cut, none))) == [
        "corners 18",
        "error no binary STL: 2 triangles need 184 bytes, the file has 183",
        "error an STL file of 0 bytes; the head alone has 84",
    ]


def test_all_of_the_plugin_compiles_beside_stand_ins_for_unreal(tmp_path: Path) -> None:
    sources = tmp_path / "sources"
    shutil.copytree(MODULE, sources)
    heads = tmp_path / "engine"
    for path in [*sources.rglob("*.h"), *sources.rglob("*.cpp")]:
        text = path.read_text()
        # Unreal's header tool writes the name of the parent class.
        for name in re.findall(r"^class ARMBRIDGE_API \w+ : public (\w+)", text, re.MULTILINE):
            text = text.replace("GENERATED_BODY()", f"public: using Super = {name}; private:")
        path.write_text(text)
        for included in re.findall(r'#include "([\w/.]+)"', text):
            ours = [sources / "Public", sources / "Private", path.parent]
            if not included.startswith("rapidjson/") and not any((folder / included).exists() for folder in ours):
                head = heads / included
                head.parent.mkdir(parents=True, exist_ok=True)
                head.write_text(f'#include "{TESTS / "StandIns.h"}"\n')
    folders = [f"-I{folder}" for folder in (sources / "Public", sources / "Private", heads)]
    # Unreal's own code leaves parameters unused, as its delegates want them.
    for source in sorted(sources.rglob("*.cpp")):
        compiled("-fno-exceptions", "-Wno-unused-parameter", "-fsyntax-only", *folders, str(source))
