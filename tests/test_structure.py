"""Tests follow the folders of the source: each module is reached by the tests of its own folder."""

import ast
import re
from pathlib import Path

from harness.server import ROOT
from tests.helpers.source import ROOMS, imports, name_of, paths

# Code around the program; tests and benchmarks share harness/.
HELPED = ("tests", "benchmarks", "harness")

# Where the tests of a folder lie: what needs several processes, or real time, in the second.
RINGS = ("tests", "tests/processes")

# Modules that hold only data or names, or run what others define; and the one process main that end-to-end tests run.
WITHOUT_TEST = {
    "planners.messages",
    # A child's main: run by the tests of the handle on it.
    "robot.control.loop",
}


def imported_by(path: Path) -> frozenset[str]:
    """Full names of the modules that a module imports, and of what it imports from them."""
    return imports(path).names | imports(path).sources


def test_every_module_is_reached_by_the_tests_of_its_folder() -> None:
    imported = {
        name_of(path): imported_by(path) for room in (*ROOMS, "tests", "harness") for path in paths(room, "[!_]*.py")
    }
    missed: set[str] = set()
    for folder in sorted({path.parent.relative_to(ROOT) for room in ROOMS for path in paths(room)}):
        tests = [path for ring in RINGS for path in (ROOT / ring / folder).glob("*.py")]
        reached: set[str] = set()
        found = set[str]().union(*map(imported_by, tests)) & imported.keys()
        while found:
            reached |= found
            found = set[str]().union(*(imported[name] for name in found)) & imported.keys() - reached
        missed |= {name_of(path) for path in (ROOT / folder).glob("[!_]*.py")} - reached
    untested = sorted(missed - WITHOUT_TEST)
    assert untested == [], (
        "import each of these modules in a test of its own folder, as tests/robot/control/test_motion.py does for "
        "robot/control/motion.py (or tests/processes/robot/control/); a module of data only goes into WITHOUT_TEST of "
        "tests/test_structure.py"
    )


def test_tests_and_benchmarks_import_nothing_of_each_other() -> None:
    known = {name_of(path) for room in HELPED for path in paths(room)}
    foreign, missing = [], []
    for room in HELPED:
        for path in paths(room):
            for name in imports(path).sources:
                place = f"{path.relative_to(ROOT)} imports {name}"
                foreign += [place] if name.split(".")[0] in {"tests", "benchmarks"} - {room} else []
                missing += [place] if name.startswith(("harness.", "tests.helpers.")) and name not in known else []
    assert foreign == [], "move the helpers of both to harness/"
    assert missing == [], "servers, clients, waiting and the page are in harness/, other helpers in tests/helpers/"


def test_every_motion_that_the_server_sends_to_an_arm_names_the_stop_epoch_of_its_request() -> None:
    """Else it would count as requested when it is sent, after any stop that has overtaken it."""
    nameless, count = [], 0
    for path in paths("server"):
        text = path.read_text()
        # Most modules send none; they need not be parsed.
        for node in ast.walk(ast.parse(text)) if re.search(r"arm\.(execute|stream)\(", text) else ():
            if isinstance(node, ast.Call) and re.search(r"\b_?arm\.(execute|stream)$", ast.unparse(node.func)):
                count += 1
                if "epoch" not in {each.arg for each in node.keywords}:
                    nameless.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert nameless == [], "pass epoch=..., the stop epoch of the request, in each of these calls"
    assert count > 0
