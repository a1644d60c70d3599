"""Every module has a test of its own name, so that its place is found from either side."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("server", "planners", "robot", "protocol")

# Modules that hold only data or names, or run what others define; and the one process main that end-to-end tests run.
WITHOUT_TEST = {
    "robot/messages.py",
    "robot/guard_limits.py",
    "robot/hardware/interface.py",
    "planners/messages.py",
    "planners/goals.py",
    "planners/problem.py",
    "planners/rates.py",
    "planners/scene.py",
    "planners/servo/question.py",
    "server/errors.py",
    "robot/errors.py",
    "server/moveit/parameters.py",
    "server/moveit/motions.py",
    # A child's main: run by the tests of the handle on it.
    "robot/control/loop.py",
}


def test_every_module_has_a_test_file() -> None:
    missing = [
        str(path.relative_to(ROOT))
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        if not path.name.startswith("__")
        and str(path.relative_to(ROOT)) not in WITHOUT_TEST
        and not (ROOT / "tests" / path.relative_to(ROOT).with_name(f"test_{path.name}")).exists()
    ]
    assert not missing
