"""Commands, programs, messages, settings and links of README and docs: run or sent where possible, else checked."""

from __future__ import annotations

import ast
import json
import re
import shlex
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect

from server import cli
from server.config_loader import load
from tests.helpers.server import ROOT, RunningServer
from tests.test_readme import blocks

PAGES = sorted((ROOT / "docs").glob("*.md"))
SERVER_PORT = "9090"
RUN_TIMEOUT_S = 60
ANSWER_TIMEOUT_S = 60

# Beginnings of commands of other programs, which are not run.
FOREIGN = (
    "python3 -m venv ",
    "python3 -m http.server ",
    "/tmp/lab/bin/pip install ",
    ".venv/bin/pip install --editable '.[",
    "dask ",
    "export RMW_IMPLEMENTATION=",
    "ros2 ",
    "docker ",
    "socat ",
    "lerobot-calibrate ",
)

# Pages whose JSON blocks hold only messages to the server; the page of the protocol also shows answers.
SENT = ("browser.md", "goals.md", "operations.md", "unity.md", "unreal.md")
WITH_CODE = ("browser.md", "unity.md", "unreal.md")


def commands(page: str) -> list[str]:
    """The lines of a page's sh blocks, without their comments, and its commands within sentences."""
    text = (ROOT / page).read_text()
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    lines += re.findall(r"`((?:armbridge|make) [^`]+)`", text)
    stripped = (re.split(r"\s+#|\s+>", line)[0].strip() for line in lines)
    return [line for line in stripped if line]


COMMANDS = sorted({line for page in ("README.md", *(f"docs/{page.name}" for page in PAGES)) for line in commands(page)})
PROGRAMS = [(page.name, block) for page in PAGES for block in blocks(page, "python")]
# A file of tokens is no configuration; it is read by the tests of tokens.
SETTINGS = [block for page in PAGES for block in blocks(page, "toml") if "_tokens]" not in block]
# They need two arms; tests/examples runs them with those.
TWO_ARMS = (
    "python examples/two_hands.py",
    "python examples/leader_follower.py --leader /leader/joint_states",
)
OF_EXAMPLES = [line for line in COMMANDS if "examples/" in line and not line.startswith((*FOREIGN, "armbridge "))]
EXAMPLES = [line for line in OF_EXAMPLES if line not in TWO_ARMS]


def run_python(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=RUN_TIMEOUT_S, check=False
    )


@pytest.mark.parametrize("program", [block for _, block in PROGRAMS], ids=[page for page, _ in PROGRAMS])
def test_a_python_program_of_the_docs_runs(program: str, simulated_server: RunningServer) -> None:
    assert f"port={SERVER_PORT}" in program
    done = run_python(["-c", program.replace(SERVER_PORT, str(simulated_server.port))])
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("page", ["README.md", "tests/ATTACKS.md", *(f"docs/{page.name}" for page in PAGES)])
def test_the_modules_that_a_page_names_exist(page: str) -> None:
    named = set(re.findall(r"`([\w/.-]+\.py)`", (ROOT / page).read_text()))
    folders = [ROOT / folder for folder in ("", "server", "planners", "robot", "robot/control", "protocol", "tests")]
    assert [name for name in sorted(named) if not any((folder / name).exists() for folder in folders)] == []


@pytest.mark.parametrize("command", EXAMPLES)
def test_a_command_with_an_example_succeeds(command: str, simulated_server: RunningServer) -> None:
    _, *arguments = shlex.split(command)
    port = str(simulated_server.port)
    arguments = [port if word == SERVER_PORT else word for word in arguments]
    done = run_python(arguments if port in arguments else [*arguments, "--port", port])
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("command", [line for line in COMMANDS if line.startswith("armbridge ")])
def test_a_command_of_armbridge_and_its_options_exist(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    name, *rest = shlex.split(command)[1:]
    with pytest.raises(SystemExit) as ended:
        cli.main([name, "--help"])
    assert ended.value.code == 0
    known = re.findall(r"--[\w-]+", capsys.readouterr().out)
    assert [word for word in rest if word.startswith("--") and word not in known] == []


@pytest.mark.parametrize("command", [line for line in COMMANDS if line.startswith("armbridge config")])
def test_a_command_about_the_configuration_succeeds(command: str) -> None:
    assert cli.main(shlex.split(command)[1:]) == 0


@pytest.mark.parametrize("command", [line for line in COMMANDS if line.startswith("make ")])
def test_a_target_of_make_exists(command: str) -> None:
    done = subprocess.run(
        [*shlex.split(command), "-n"], cwd=ROOT, capture_output=True, text=True, timeout=30, check=False
    )
    assert done.returncode == 0, done.stderr


def test_every_other_command_is_known_to_be_of_others() -> None:
    ours = ("armbridge ", "make ")
    assert [line for line in COMMANDS if not line.startswith((*ours, *FOREIGN)) and line not in OF_EXAMPLES] == []


@pytest.mark.parametrize("command", ["scheduler", "worker"])
def test_the_options_of_commands_of_dask_exist(command: str) -> None:
    pytest.importorskip("distributed", reason="the extra [dask] is not installed")
    told = {
        word for line in COMMANDS if line.startswith(f"dask {command} ") for word in line.split() if word[:2] == "--"
    }
    (entry,) = entry_points(group="dask_cli", name=command)
    assert told
    assert told <= {option for parameter in entry.load().params for option in parameter.opts + parameter.secondary_opts}


def messages_in_code(page: str) -> list[str]:
    """Operations that the code on a page (C++, C# or JavaScript) sends after connecting."""
    text = (ROOT / "docs" / page).read_text()
    frames = re.findall(r"TEXT\(R\"\((.*?)\)\"\)", text)
    frames += [line.replace('""', '"') for line in re.findall(r"@\"(\{.*\})\"", text)]
    for name, type_name in re.findall(r"name: \"(/\w+)\", messageType: \"([\w/]+)\"", text):
        frames += [json.dumps({"op": op, "topic": name, "type": type_name}) for op in ("advertise", "subscribe")]
    return frames


@pytest.mark.parametrize("page", SENT)
def test_the_messages_of_a_page_are_taken_without_complaint(page: str, simulated_server: RunningServer) -> None:
    frames = [line for block in blocks(ROOT / "docs" / page, "json") for line in block.splitlines()]
    assert frames
    in_code = messages_in_code(page)
    assert bool(in_code) is (page in WITH_CODE)
    frames += in_code
    calls = {frame["id"] for frame in map(json.loads, frames) if frame["op"] == "call_service"}
    complaints = []
    with connect(f"ws://127.0.0.1:{simulated_server.port}") as client:

        def call_and_wait(service: str, waited_for: set[str]) -> None:
            client.send(json.dumps({"op": "call_service", "service": service, "id": service}))
            left = {service, *waited_for}
            while left:
                operation = json.loads(client.recv(timeout=ANSWER_TIMEOUT_S))
                refused = operation["op"] == "service_response" and not operation["result"]
                if operation["op"] == "status" or refused:
                    complaints.append(operation)
                left.discard(operation.get("id"))
                calls.discard(operation.get("id"))

        client.send(json.dumps({"op": "set_level", "level": "warning"}))
        for frame in frames:
            client.send(frame)
            # A stop overtakes what waits: the frame is carried out before the next is sent, as where a person sends.
            call_and_wait("/rosapi/get_time", set())
        call_and_wait("/arm/stop", calls)
    assert complaints == []


@pytest.mark.parametrize(
    "settings", [block for page in PAGES for block in blocks(page, "toml") if "_tokens]" not in block]
)
def test_the_settings_of_a_page_are_taken(settings: str, tmp_path: Path) -> None:
    file = tmp_path / "armbridge.toml"
    file.write_text(settings)
    load(file, {})


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub derives them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_heading_that_is_linked_exists() -> None:
    missing = []
    for page in (ROOT / "README.md", ROOT / "tests" / "ATTACKS.md", *PAGES):
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#([^)]+)\)", page.read_text()):
            linked = page.parent / target if target else page
            if anchor not in anchors(linked):
                missing.append(f"{page.name} links to {target}#{anchor}")
    assert missing == []


def test_every_test_that_the_table_of_attacks_names_exists() -> None:
    named = re.findall(r"`([\w/.]+\.py)::(\w+)`", (ROOT / "tests" / "ATTACKS.md").read_text())
    assert len(named) > 10
    assert [name for file, name in named if f"def {name}(" not in (ROOT / "tests" / file).read_text()] == []


def printed_sentences() -> str:
    """Strings of the code as they are printed, one a line, with an ellipsis for each value."""
    found = []
    for file in (
        path for folder in ("planners", "protocol", "robot", "server") for path in (ROOT / folder).rglob("*.py")
    ):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr):
                found.append(
                    "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(re.sub(r"%\.?\w*[sdgfr]|\{[\w:.]*\}", "…", node.value))
    return "\n".join(found)


def test_the_sentences_of_the_pages_about_troubles_are_printed_by_the_code() -> None:
    printed = printed_sentences()
    pages = "".join((ROOT / "docs" / page).read_text() for page in ("troubleshooting.md", "hardware.md"))
    text = re.sub(r"```.*?```", "", pages, flags=re.DOTALL)
    others = ("armbridge ", "make ", "curl ", "echo ", "journalctl ", "sudo ", "@dialout ", "{", "access.allowed_")
    quoted = [text for text in re.findall(r"`([^`]+)`", text) if text.count(" ") >= 3 and not text.startswith(others)]
    assert len(quoted) > 100
    # Some sentences are joined from two strings at a colon.
    parts = [part for text in quoted for part in re.split(r"…|: ", text)]
    assert [part for part in parts if len(part) > 4 and part.strip(" ();,") not in printed] == []


# From the engine's axes to ROS's, and metres to the engine's unit.
UNREAL = (np.diag([1.0, -1.0, 1.0]), 0.01)
UNITY = (np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 1.0)


def rotation(quaternion: list[float]) -> np.ndarray:
    """The matrix of a quaternion x, y, z, w; the formula knows no hand."""
    x, y, z, w = quaternion
    vector = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - vector @ vector) * np.eye(3) + 2.0 * np.outer(vector, vector) + 2.0 * w * cross


@pytest.mark.parametrize(("page", "engine"), [("unreal.md", UNREAL), ("unity.md", UNITY)])
def test_the_numbers_of_coordinates_agree_with_the_mirrored_axes(page: str, engine: tuple[np.ndarray, float]) -> None:
    axes, unit_m = engine
    rows = re.findall(r"^" + r"\| \(([-\d., ]+)\) " * 4, (ROOT / "docs" / page).read_text(), re.MULTILINE)
    assert len(rows) >= 3
    for row in rows:
        position, quaternion, ros_position, ros_quaternion = ([float(n) for n in cell.split(",")] for cell in row)
        assert axes @ position * unit_m == pytest.approx(ros_position)
        assert axes @ rotation(quaternion) @ axes.T == pytest.approx(rotation(ros_quaternion), abs=1e-3)
