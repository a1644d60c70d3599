"""clients/unreal: its engine-free part moves the arm, and all of it compiles beside stand-ins for Unreal."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.clients.engines import Answers, connects_as_documented, goes_round, refuses_a_cut_stl, turns_coordinates
from tests.helpers.programs import run

PLUGIN = ROOT / "clients" / "unreal" / "Armbridge"
MODULE = PLUGIN / "Source" / "Armbridge"
TESTS = ROOT / "clients" / "unreal" / "Tests"
AXES = np.diag([1.0, -1.0, 1.0])
# Unreal builds modules without exceptions and run-time types.
COMPILE = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fno-rtti"]

pytestmark = pytest.mark.skipif(
    shutil.which("g++") is None or not Path("/usr/include/rapidjson").exists(),
    reason="no C++ compiler, or no RapidJSON: apt-get install g++ rapidjson-dev",
)


def compiled(*arguments: str) -> None:
    done = run(*COMPILE, *arguments)
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


@pytest.fixture
def answers(driver: Path) -> Answers:
    def of(*lines: str) -> list[str]:
        text = "\n".join(lines) + "\n"
        done = run(driver, input=text)
        assert done.returncode == 0, done.stderr
        return [line for line in done.stdout.splitlines() if line != "end"]

    return of


def test_a_lost_connection_ends_what_was_asked_once(answers: Answers) -> None:
    lost = "-25 the connection was lost before the goal's end came; the arm may still be moving"
    assert answers("named ready", "gripper 1", "lose", "lose")[2:] == [
        f"goal {lost}",
        "gripper 0 the connection was lost before the gripper's end came",
    ]


def test_frames_that_are_no_json_or_of_another_shape_have_no_events(answers: Answers) -> None:
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


def test_a_goal_that_is_no_number_is_not_made(answers: Answers) -> None:
    assert answers("joint shoulder_pan nan", "tip nan 0 0", "gripper nan", "lose") == [
        "error the position of shoulder_pan is no number",
        "error the pose of the tip holds what is no number",
        "error the gripper's position or effort is no number",
    ]


def test_a_connection_begins_with_messages_of_the_page_and_is_tried_again(answers: Answers) -> None:
    connects_as_documented(answers)


def test_a_token_is_the_first_frame(answers: Answers) -> None:
    assert answers('setup "secret')[0] == 'send {"op":"auth","token":"\\"secret"}'


def test_coordinates_are_the_mirrored_axes(answers: Answers) -> None:
    turns_coordinates(answers, AXES, 100.0)


def test_an_stl_that_is_cut_off_is_refused_with_its_sizes(tmp_path: Path, answers: Answers) -> None:
    refuses_a_cut_stl(answers, tmp_path, b"", "error an STL file of 0 bytes; the head alone has 84")


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
