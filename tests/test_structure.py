"""Tests follow the folders of the source: each module is reached by the tests of its own folder."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("server", "planners", "robot", "protocol")

# Where the tests of a folder lie: what needs several processes, or real time, in the second.
RINGS = ("tests", "tests/processes")

# Modules that hold only data or names, or run what others define; and the one process main that end-to-end tests run.
WITHOUT_TEST = {
    "planners.messages",
    # A child's main: run by the tests of the handle on it.
    "robot.control.loop",
}


def folders() -> list[Path]:
    """Every folder of the source that holds modules."""
    return sorted(
        {path.parent for room in ROOMS for path in (ROOT / room).rglob("*.py") if "node_modules" not in path.parts}
    )


def imported_by(path: Path) -> set[str]:
    """Full names of the modules that a test imports, and of what it imports from them."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.fixture
def imports() -> dict[str, set[str]]:
    """Imports of each module of the source and of the tests' helpers, by its full name."""
    places = (*ROOMS, "tests")
    paths = [path for room in places for path in (ROOT / room).rglob("[!_]*.py") if "node_modules" not in path.parts]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): imported_by(path) for path in paths}


def test_every_module_is_reached_by_the_tests_of_its_folder(imports: dict[str, set[str]]) -> None:
    missed: set[str] = set()
    for folder in (path.relative_to(ROOT) for path in folders()):
        tests = [path for ring in RINGS for path in (ROOT / ring / folder).glob("*.py")]
        reached: set[str] = set()
        found = set().union(*(imported_by(path) for path in tests)) & imports.keys()
        while found:
            reached |= found
            found = set().union(*(imports[name] for name in found)) & imports.keys() - reached
        missed |= {".".join((*folder.parts, path.stem)) for path in (ROOT / folder).glob("[!_]*.py")} - reached
    assert missed - WITHOUT_TEST == set()


def test_every_motion_that_the_server_sends_to_an_arm_names_the_stop_epoch_of_its_request() -> None:
    """Else it would count as requested when it is sent, after any stop that has overtaken it."""
    nameless = []
    for path in (ROOT / "server").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            arm = ast.unparse(node.func.value).rpartition(".")[2] in ("arm", "_arm")
            if arm and node.func.attr in ("execute", "stream") and "epoch" not in {each.arg for each in node.keywords}:
                nameless.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert nameless == []
