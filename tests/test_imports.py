"""The arrows between the rooms: server -> planners -> robot, server -> protocol, and no other."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("server", "planners", "robot", "protocol")

# What each room may import of ours; a name with a dot is one module of a room. docs/architecture.md shows it.
ALLOWED = {
    "server": (
        "server",
        "protocol",
        "robot",
        "planners.cartesian.spline",
        "planners.goals",
        "planners.scene",
        "planners.scene_checks",
        "planners.problem",
        "planners.files.problem_file",
        "planners.files.plan_command",
        "planners.assistant",
        "planners.errors",
        "planners.pool",
        "planners.pool_host",
        "planners.shared_pool",
        "planners.servo.question",
    ),
    "planners": (
        "planners",
        "robot.description",
        "robot.errors",
        "robot.trajectory",
        "robot.channel",
        "robot.processes",
    ),
    "robot": ("robot",),
    "protocol": ("protocol",),
}
PURPOSES = {
    "server": "asyncio, sockets, configuration: what clients meet",
    "planners": "problem in, plan out",
    "robot": "the arm: description, hardware, control",
    "protocol": "the wire: bytes in, operations out",
}

# Only the server knows sockets of clients and configuration; the handles on child processes know asyncio.
ASYNCIO_OUTSIDE_SERVER = {
    "robot/processes.py",
    "robot/arm.py",
    "robot/arm_group.py",
    "robot/arm_interface.py",
    "planners/pool.py",
    "planners/pool_host.py",
    "planners/race.py",
    "planners/shared_pool.py",
}
PLANNING_LIBRARIES = {"placo", "pinocchio", "coal", "ompl", "toppra"}


def modules(room: str) -> Iterator[Path]:
    yield from (path for path in sorted((ROOT / room).rglob("*.py")) if "node_modules" not in path.parts)


def imports(path: Path) -> set[str]:
    """Full names of all that a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def allowed(name: str, room: str) -> bool:
    return any(name == prefix or name.startswith(f"{prefix}.") for prefix in ALLOWED[room])


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_the_rooms_below_it(room: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in modules(room)
        for name in imports(path)
        if name.split(".")[0] in ROOMS and not allowed(name, room)
    ]
    assert not wrong


@pytest.mark.parametrize("room", ["planners", "robot", "protocol"])
def test_asyncio_and_websockets_stay_in_the_server(room: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in modules(room)
        for name in imports(path)
        if name.split(".")[0] in {"asyncio", "websockets", "uvloop", "pydantic_settings"}
        and str(path.relative_to(ROOT)) not in ASYNCIO_OUTSIDE_SERVER
    ]
    assert not wrong


def test_the_protocol_does_no_io_and_reads_no_clock() -> None:
    # It begins no thread; a budget is one for each.
    allowed = "protocol/messages.py imports threading"
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in modules("protocol")
        for name in imports(path)
        if name.split(".")[0] in {"socket", "time", "select", "threading", "logging", "subprocess"}
    ]
    assert wrong == [allowed]


@pytest.fixture(scope="module")
def loaded_by_the_server() -> set[str]:
    """The modules of a server process that has not yet started."""
    program = "import sys, server.app; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    return set(loaded.stdout.split())


def test_the_server_process_loads_no_planning_library(loaded_by_the_server: set[str]) -> None:
    assert loaded_by_the_server & PLANNING_LIBRARIES == set()


def test_a_server_starts_without_loading_what_only_few_need(loaded_by_the_server: set[str]) -> None:
    """The metrics' library is loaded: it counts from the start, and takes 20 to 30 ms of the 1.3 s of imports."""
    assert {"server.monitoring.monitor", "server.zenoh.bridge", "prometheus_client"} <= loaded_by_the_server
    assert not {"zenoh", "mcap", "distributed"} & loaded_by_the_server


def import_table() -> str:
    """Return the rooms and what they import, as a table of docs/architecture.md."""
    lines = ["| room | imports of ours | purpose |", "|---|---|---|"]
    for room, names in ALLOWED.items():
        others = [f"`{name}`" for name in names if name != room]
        lines.append(f"| `{room}/` | {', '.join(others) or 'nothing'} | {PURPOSES[room]} |")
    return "\n".join(lines)


def test_the_architecture_page_shows_these_imports() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    shown = page.split("<!-- imports -->")[1].split("<!-- /imports -->")[0].strip()
    assert shown == import_table()


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): imports_when_loaded(path)
        for room in ROOMS
        for path in modules(room)
    }
    order = TopologicalSorter({name: {each for each in found if each in graph} for name, found in graph.items()})
    order.prepare()


def imports_when_loaded(path: Path) -> set[str]:
    """Return the modules that a module imports when it is loaded, so not for its types alone, nor in a function."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names
