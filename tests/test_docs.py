"""Commands, settings, sentences and links of README and docs; programs are run by tests/processes/test_docs.py."""

import math
import os
import re
import shlex
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from harness.page import page_digest
from harness.server import ROOT
from planners.problem import MoveItErrorCode
from protocol.registry import Registry
from robot.description.limits import END_STOP_MARGIN_RAD
from robot.description.robot_folder import built_in_names
from robot.faults import ADVICE, REMEDIES, FaultCode
from server import cli
from server.config_loader import load
from tests.helpers.programs import run
from tests.helpers.source import PACKAGES, paths, sentences
from tests.test_readme import blocks

PAGES = sorted((ROOT / "docs").glob("*.md"))
# The pages that a repository shows at its top.
TOP = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "ARCHITECTURE.md")

# Beginnings of commands of other programs, which are not run.
FOREIGN = (
    "curl --json ",
    "pipx install ",
    "python3 -m http.server ",
    "python3 -m venv ",
    "source .venv/bin/activate",
    "uvx ",
    "/tmp/lab/bin/pip install ",
    # tests/clients/python/test_command.py runs it.
    "python -m armbridge_client ",
    ".venv/bin/pip install --editable '.[",
    "dask ",
    "export RMW_IMPLEMENTATION=",
    "ros2 ",
    "docker ",
    "docker/",
    "socat ",
    "lerobot-",
    "armbridge-dataset ",
    "armbridge-policy ",
    "pip install ./clients/python ",
    "git clone REPOSITORY ",
)


def commands(page: str) -> list[str]:
    """The lines of a page's sh blocks, without their comments, and its commands within sentences."""
    text = (ROOT / page).read_text()
    lines = [
        line
        for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        for line in block.replace("\\\n", "").splitlines()
    ]
    lines += re.findall(r"`((?:armbridge|make) [^`]+)`", text)
    # Without comment, redirection and the variables set for the command.
    stripped = (re.sub(r"^([A-Z_]+=\S* )+", "", re.split(r"\s+#|\s+>", line)[0].strip()) for line in lines)
    return [line for line in stripped if line]


COMMANDS = sorted({line for page in (*TOP, *(f"docs/{page.name}" for page in PAGES)) for line in commands(page)})
# A file of tokens is no configuration; it is read by the tests of tokens.
SETTINGS = [block for page in PAGES for block in blocks(page, "toml") if "_tokens]" not in block]
# They need two arms, servos or physics; tests/examples runs them with these.
OF_OTHER_ARMS = (
    "python examples/two_hands.py",
    "python examples/pick_and_place.py",
    "python examples/stack_three.py",
    "python examples/push_a_block.py",
    "python examples/record_episodes.py",
    "python examples/servo_experiments.py --serial auto",
    "python examples/leader_follower.py --leader /leader/joint_states",
)
OF_EXAMPLES = [line for line in COMMANDS if "examples/" in line and not line.startswith((*FOREIGN, "armbridge "))]
EXAMPLES = [line for line in OF_EXAMPLES if line not in OF_OTHER_ARMS]


def test_the_modules_that_pages_name_exist() -> None:
    folders = [ROOT / folder for folder in ("", "server", "planners", "robot", "robot/control", "protocol", "tests")]
    for page in (*(ROOT / name for name in TOP), ROOT / "tests" / "ATTACKS.md", *PAGES):
        named = set(re.findall(r"`([\w/.-]+\.py)`", page.read_text()))
        missing = [name for name in sorted(named) if not any((folder / name).exists() for folder in folders)]
        assert missing == [], f"{page.relative_to(ROOT)} names modules that do not exist; correct their names there"


def test_the_commands_of_armbridge_and_their_options_exist(capsys: pytest.CaptureFixture[str]) -> None:
    known: dict[str, list[str]] = {}
    for command in (line for line in COMMANDS if line.startswith("armbridge ")):
        name, *rest = shlex.split(command)[1:]
        if name not in known:
            with pytest.raises(SystemExit) as ended:
                cli.main([name, "--help"])
            assert ended.value.code == 0, command
            known[name] = re.findall(r"--[\w-]+", capsys.readouterr().out)
        assert [word for word in rest if word.startswith("--") and word not in known[name]] == [], (
            f"`{command}` names options that do not exist: correct it in README.md or docs/"
        )
        if name == "config":
            assert cli.main([name, *rest]) == 0, f"`{command}` fails: correct it in README.md or docs/"


def test_the_targets_of_make_exist_and_the_workflow_and_the_hooks_run_what_the_makefile_has() -> None:
    words = {word for line in COMMANDS if line.startswith("make ") for word in shlex.split(line)[1:]}
    done = run("make", "-n", *sorted(words))
    assert done.returncode == 0, f"a `make ...` of README.md or docs/ is no target of the Makefile: {done.stderr}"
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text())
    steps = [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]
    assert {".ci/run", "make test"} <= set(steps)
    repos = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    hooks = {Path(hook["entry"].split()[0]).name for repo in repos for hook in repo["hooks"]}
    lint = (ROOT / "Makefile").read_text().split("\nlint:")[1].split("\n\n")[0]
    assert hooks == set(re.findall(r"\$\(BIN\)/(\w+)", lint))


def test_every_other_command_is_known_to_be_of_others_and_no_server_on_the_network_would_refuse_to_start() -> None:
    ours = ("armbridge ", "make ")
    unknown = [line for line in COMMANDS if not line.startswith((*ours, *FOREIGN)) and line not in OF_EXAMPLES]
    assert unknown == [], "correct them in README.md or docs/, or add their beginning to FOREIGN in tests/test_docs.py"
    opened = [line for line in COMMANDS if line.startswith("armbridge serve ") and "--host 0.0.0.0" in line]
    assert opened
    assert [line for line in opened if "--insecure" not in line and "--config" not in line] == [], (
        "without a token the server does not start: add --config armbridge.toml"
    )


@pytest.mark.parametrize("command", ["scheduler", "worker"])
def test_the_options_of_commands_of_dask_exist(command: str) -> None:
    pytest.importorskip("distributed", reason="the extra [dask] is not installed")
    lines = [line for line in COMMANDS if line.startswith(f"dask {command} ")]
    told = set(re.findall(r"--[\w-]+", " ".join(lines)))
    (entry,) = entry_points(group="dask_cli", name=command)
    assert told
    assert told <= {option for parameter in entry.load().params for option in parameter.opts + parameter.secondary_opts}


def test_the_settings_of_pages_are_taken_and_none_takes_the_default_speed_for_a_limit(tmp_path: Path) -> None:
    """A goal may name a higher speed than moveit.max_velocity_scaling, never one above arm.speed_limit."""
    file = tmp_path / "armbridge.toml"
    for settings in SETTINGS:
        file.write_text(settings)
        load(file, {})
    lowered = [
        page.name
        for page in PAGES
        for block in (*blocks(page, "toml"), *blocks(page, "sh"))
        if "max_velocity_scaling" in block and "speed_limit" not in block
    ]
    assert lowered == [], "set arm.speed_limit beside it"


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub derives them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "examples" / "browser_page.html"], ids=lambda page: page.name)
def test_raw_examples_that_register_topics_ask_for_refusals_first(page: Path) -> None:
    """Without set_level, the server is silent about all that a reader changes wrongly in them."""
    text = page.read_text()
    examples = [text] if page.suffix == ".html" else blocks(page, "json")
    # Pages explain single operations, and what a library sends, in shorter blocks.
    for example in examples:
        if len(re.findall(r'"?op"?: ?"(?:advertise|subscribe)"', example)) > 1:
            assert re.search(r'"?op"?: ?"set_level".*?"advertise"', example, re.DOTALL), (
                f"{page.name}: put " + '{"op":"set_level","level":"error"}' + f" before the first advertise\n{example}"
            )


def test_every_page_and_heading_that_is_linked_exists() -> None:
    missing = []
    for page in (*(ROOT / name for name in TOP), ROOT / "tests" / "ATTACKS.md", *PAGES):
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", page.read_text()):
            linked = page.parent / target if target else page
            if not linked.exists() or (anchor and anchor not in anchors(linked)):
                missing.append(f"{page.name} links to {target}#{anchor}")
    assert missing == [], "correct the links in the first named page, or the headings in the second"


def test_the_pictures_show_the_page_as_it_is() -> None:
    pictured = (ROOT / "docs" / "pictures" / "page.sha256").read_text().strip()
    assert pictured == page_digest(), "the page has changed since docs/pictures was made: run `make pictures`"


@pytest.mark.parametrize("table", ["ATTACKS.md", "TRAPS.md"])
def test_every_test_that_the_tables_of_attacks_and_of_traps_name_exists(table: str) -> None:
    named = re.findall(r"`([\w/.]+\.py)::(\w+)`", (ROOT / "tests" / table).read_text())
    assert len(named) > 10
    missing = [name for file, name in named if f"def {name}(" not in (ROOT / "tests" / file).read_text()]
    assert missing == [], f"tests/{table} names tests that do not exist; correct the table"


def test_the_sentences_of_the_pages_about_troubles_are_printed_by_the_code() -> None:
    printed = "\n".join(text for package in PACKAGES for path in paths(package) for text in sentences(path))
    pages = "".join((ROOT / "docs" / page).read_text() for page in ("troubleshooting.md", "hardware.md"))
    text = re.sub(r"```.*?```", "", pages, flags=re.DOTALL)
    others = ("armbridge ", "make ", "curl ", "echo ", "journalctl ", "sudo ", "@dialout ", "{", "access.allowed_")
    quoted = [text for text in re.findall(r"`([^`]+)`", text) if text.count(" ") >= 3 and not text.startswith(others)]
    assert len(quoted) > 60
    # Some sentences are joined from two strings at a colon.
    parts = [part for text in quoted for part in re.split(r"…|: ", text)]
    missing = [part for part in parts if len(part) > 4 and part.strip(" ();,") not in printed]
    assert missing == [], "the code prints no such sentence: correct it in docs/troubleshooting.md or docs/hardware.md"


# From the engine's axes to ROS's, and metres to the engine's unit.
UNREAL = (np.diag([1.0, -1.0, 1.0]), 0.01)
UNITY = (np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 1.0)


def rotation(quaternion: list[float]) -> np.ndarray:
    """The matrix of a quaternion x, y, z, w; the formula knows no hand."""
    x, y, z, w = quaternion
    vector = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - vector @ vector) * np.eye(3) + 2.0 * np.outer(vector, vector) + 2.0 * w * cross


def section(page: str, heading: str) -> str:
    """A section of the second level, with the sections below it."""
    return (ROOT / "docs" / page).read_text().split(f"\n## {heading}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize(("heading", "engine"), [("Unreal", UNREAL), ("Unity", UNITY)])
def test_the_numbers_of_coordinates_agree_with_mirrored_axes(heading: str, engine: tuple[np.ndarray, float]) -> None:
    axes, unit_m = engine
    rows = re.findall(r"^" + r"\| \(([-\d., ]+)\) " * 4, section("engines.md", heading), re.MULTILINE)
    assert len(rows) >= 3
    for row in rows:
        position, quaternion, ros_position, ros_quaternion = ([float(n) for n in cell.split(",")] for cell in row)
        assert axes @ position * unit_m == pytest.approx(ros_position)
        assert axes @ rotation(quaternion) @ axes.T == pytest.approx(rotation(ros_quaternion), abs=1e-3)


@pytest.mark.parametrize("heading", ["Unreal", "Unity"])
def test_the_rate_of_joint_angles_is_that_of_the_throttle(heading: str) -> None:
    """Of messages at a fixed rate, a throttle lets every second, third, ... one through."""
    messages = section("engines.md", "Unreal")
    (throttle_ms,) = re.findall(r'"/joint_states","type":"sensor_msgs/JointState","throttle_rate":(\d+)', messages)
    rate_hz = load(None, {}).arm.joint_state_rate_hz
    each = math.ceil(float(throttle_ms) * rate_hz / 1000.0)
    text = section("engines.md", heading)
    assert re.findall(r"measured .* (\d+) times a second", text) == [f"{rate_hz / each:g}"]


def test_the_speed_the_types_and_the_remedies_of_the_readme_and_the_pages_are_those_of_the_code() -> None:
    readme = (ROOT / "README.md").read_text()
    assert f"{load(None, {}).moveit.max_velocity_scaling:.0%}".replace("%", " %") in readme
    assert load(None, {}).arm.speed_limit == 1.0, "README: without arm.speed_limit, a client may use full speed"
    names, page = list(Registry.load().type_names()), (ROOT / "docs" / "protocol.md").read_text()
    assert set(re.findall(r"knows (\d+) types of ROS 2", page)) == {str(len(names))}
    arm = (ROOT / "docs" / "arm.md").read_text()
    assert f"less {END_STOP_MARGIN_RAD} rad at each end" in arm
    # What the supply must give: the pages, the advice of a fault, and that of the doctor.
    for text in (
        *((ROOT / "docs" / page).read_text() for page in ("hardware.md", "troubleshooting.md")),
        *(REMEDIES[FaultCode.VOLTAGE_LOW], (ROOT / "robot" / "commissioning" / "doctor.py").read_text()),
    ):
        assert "4 A or more" in text


def test_no_page_says_that_an_arm_has_moved_on_metal() -> None:
    """Until one has: then change the README, docs/hardware.md and docs/robots.md together."""
    assert "No real arm has moved with armbridge yet" in (ROOT / "README.md").read_text()
    assert "Nobody has run armbridge on a real arm yet" in (ROOT / "docs" / "hardware.md").read_text()
    robots = (ROOT / "docs" / "robots.md").read_text()
    assert "No built-in arm has been driven on metal" in robots
    rows = re.findall(
        r"^\| `(\w+)` \|.*\| ([^|]+) \|$", robots.split("## Built-in arms")[1].split("##")[0], re.MULTILINE
    )
    assert {name for name, _ in rows} == set(built_in_names())
    assert {tried for _, tried in rows} == {"emulated bus", "-"}


def defaults_of(name: str) -> list[set[float]]:
    """The numbers that a name in a table may stand for: each setting, constant or environment variable of that name."""
    found: list[set[float]] = [{float(os.environ[name])}] if name in os.environ else []
    settings = load(None, {}).model_dump()
    for path in (name, f"server.{name}", f"server.limits.{name}"):
        value: Any = settings
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        found += [{float(value)}] if isinstance(value, int | float) else []
    for text in re.findall(rf"^(?:[A-Z_]+, )*{name}\b(?:, [A-Z_]+)* = (.+)$", SOURCES, re.MULTILINE):
        found.append({float(eval(number)) for number in re.findall(r"\d[\d_.]*(?: (?:\*\*?|<<) \d[\d_]*)*", text)})
    return found


SOURCES = "\n".join(path.read_text() for package in PACKAGES for path in paths(package))


@pytest.mark.parametrize("page", ["protocol.md", "security.md"])
def test_the_limits_in_tables_are_those_of_the_settings_and_constants_that_stand_beside_them(page: str) -> None:
    rows = re.findall(r"^\| (.+) \|$", (ROOT / "docs" / page).read_text(), re.MULTILINE)
    checked = 0
    for _, shown, *_, last in (cells for row in rows if len(cells := row.split(" | ")) > 2):
        found = re.findall(r"(?<![\d.])\d[\d ]*(?:\.\d+)?(?![\d.])", shown)
        numbers = {float(number.replace(" ", "")) for number in found}
        for name in re.findall(r"`((?:[a-z]+\.)?[a-z_]+|[A-Z_]+)`", last) if numbers else ():
            if defaults := defaults_of(name):
                checked += 1
                assert any(each <= numbers for each in defaults), f"{page}: {name} is {defaults}, not {shown}"
    assert checked > 4


# Constructions over which readers stumbled, each with its remedy: say the noun, the verb, the number.
STUMBLES = re.compile(
    r"\b(told|tells|anew|in hand|those of|that of|ones? that|none of|but for|of which|whoever|so many|has it that|"
    r"as it is|what is|at all|(?:is|are) to be|may be had)\b",
    re.IGNORECASE,
)
QUESTIONS = re.compile(r'^ *r?"""\s*(What |Whether |Who|Where |Which |Why |How ).*', re.MULTILINE)


def test_no_sentence_uses_a_construction_that_readers_stumble_over_and_docstrings_open_with_a_verb_or_a_noun() -> None:
    """Docs, docstrings, comments, log lines, errors, `--help` and the page; also across the end of a line."""
    named = (*TOP, "CHANGELOG.md", "server/page/src/texts/en.json")
    written = [ROOT / name for name in named] + PAGES + sorted((ROOT / "clients").rglob("README.md"))
    found, questions = [], []
    for path in (*written, *(path for folder in (*PACKAGES, "clients", "examples") for path in paths(folder))):
        name, whole = path.relative_to(ROOT), path.read_text()
        text = re.sub(r"\s*\n\s*(#\s+)?", " ", whole)
        found += [f"{name}: {text[hit.start() - 40 : hit.end()]}" for hit in STUMBLES.finditer(text)]
        questions += [f"{name}: {hit[0].strip()}" for hit in QUESTIONS.finditer(whole) if name.parts[0] in PACKAGES]
        assert "<<<<<<< " not in text, f"{name}: a merge was not resolved"
    assert found == [], "say the noun again, the verb, or the number itself"
    assert questions == []


def errors_table(heading: str) -> list[list[str]]:
    """The cells of each row of a table of docs/errors.md, without its head."""
    rows = re.findall(r"^\| (.*) \|$", section("errors.md", heading), re.MULTILINE)
    return [row.split(" | ") for row in rows[1:]]


def test_the_page_of_errors_has_every_code_fault_and_warning_with_the_remedy_of_the_code() -> None:
    codes = {name: int(value) for value, name, _, _ in errors_table("Codes of goals")}
    answered = set(re.findall(r"MoveItErrorCode\.([A-Z_]+)", SOURCES))
    assert codes == {name: MoveItErrorCode[name].value for name in answered}
    faults = {row[0]: row[-1] for row in errors_table("Faults of the arm")}
    assert faults == {code.value: REMEDIES[code] for code in FaultCode}
    warnings = {row[0]: tuple(row[1:]) for row in errors_table("Warnings of a servo")}
    assert warnings == {alert.value: (advice.means, advice.remedy()) for alert, advice in ADVICE.items()}
