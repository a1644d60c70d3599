"""The imports between packages: server -> planners -> robot, server -> protocol, and no other; tests follow folders."""

import ast
import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from harness.server import ROOT
from tests.helpers.programs import run_python
from tests.helpers.source import PACKAGES, imports, name_of, paths

# What each package may import of ours; a name with a dot is one module of a package. ARCHITECTURE.md shows it.
ALLOWED = {
    "server": (
        "server",
        "protocol",
        "robot",
        "planners.motions.spline",
        "planners.goals",
        "planners.interface",
        "planners.scene",
        "planners.scene_checks",
        "planners.problem",
        "planners.files.problem_file",
        "planners.files.plan_command",
        "planners.assistant",
        "planners.errors",
        "planners.pool",
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
        "robot.template",
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
    "planners/interface.py",
    "planners/pool.py",
    "planners/shared_pool.py",
    "planners/race.py",
}
PLANNING_LIBRARIES = {"placo", "pinocchio", "coal", "ompl", "toppra"}


def importing(packages: Iterable[str], is_wrong: Callable[[str, str], bool]) -> list[str]:
    """Which modules of some packages import a name that is wrong in that package."""
    return [
        f"{path.relative_to(ROOT)} imports {name}"
        for package in packages
        for path in paths(package)
        for name in sorted(imports(path).names)
        if is_wrong(name, package)
    ]


def test_a_room_imports_only_the_rooms_below_it() -> None:
    def is_wrong(name: str, package: str) -> bool:
        allowed = any(name == prefix or name.startswith(f"{prefix}.") for prefix in ALLOWED[package])
        return name.split(".")[0] in PACKAGES and not allowed

    found = importing(PACKAGES, is_wrong)
    assert found == [], "move the code to a folder that may import this; the folders are in ALLOWED of this file"


def test_a_client_and_the_program_import_nothing_of_each_other() -> None:
    packages = {path.parent.name for path in (ROOT / "clients").glob("*/*/__init__.py")}
    assert "armbridge_client" in packages
    found = importing(PACKAGES, lambda name, _package: name.split(".")[0] in packages)
    found += [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in paths("clients", "*.py")
        for name in sorted(imports(path).names)
        if path.parent.name in packages and name.split(".")[0] in PACKAGES
    ]
    assert found == [], "a client speaks to the server over its port alone"


def test_asyncio_and_websockets_stay_in_the_server() -> None:
    ours = {"asyncio", "websockets", "uvloop", "pydantic_settings"}
    found = importing(("planners", "robot", "protocol"), lambda name, _package: name.split(".")[0] in ours)
    wrong = [each for each in found if each.split()[0] not in ASYNCIO_OUTSIDE_SERVER]
    assert wrong == [], "move this code to server/"


def test_the_protocol_does_no_io_and_reads_no_clock() -> None:
    foreign = {"socket", "time", "select", "threading", "logging", "subprocess"}
    found = importing(("protocol",), lambda name, _package: name.split(".")[0] in foreign)
    # It begins no thread; a budget is one for each.
    assert found == ["protocol/messages.py imports threading"], "take sockets and the time as arguments, from server/"


# A server process that has not yet started, and shares nothing with other machines.
PROGRAM = """
import sys, server.app
from server.config import Settings
assert server.app._bridge_of(Settings(), None, None) is None
print(*sys.modules)
"""


def test_a_server_starts_without_planning_libraries_and_without_what_only_few_need() -> None:
    """The metrics' library is loaded: it counts from the start, and takes 20 to 30 ms of the 1.3 s of imports."""
    loaded = set(run_python(PROGRAM).stdout.split())
    assert loaded & PLANNING_LIBRARIES == set(), "import them in the functions that need them, not in the module"
    assert {"server.monitoring.monitor", "server.zenoh.settings", "prometheus_client"} <= loaded
    assert not {"zenoh", "mcap", "distributed"} & loaded


def test_the_command_line_loads_nothing_of_the_server_before_a_command_needs_it() -> None:
    loaded = set(run_python("import sys, server.cli; print(*sys.modules)").stdout.split())
    assert "server.commands.arm" in loaded
    assert not {"websockets", "uvloop", "server.app", *PLANNING_LIBRARIES} & loaded


def test_the_architecture_page_shows_these_imports() -> None:
    lines = ["| package | imports of ours | purpose |", "|---|---|---|"]
    for package, names in ALLOWED.items():
        others = [f"`{name}`" for name in names if name != package]
        lines.append(f"| `{package}/` | {', '.join(others) or 'nothing'} | {PURPOSES[package]} |")
    table, page = "\n".join(lines), (ROOT / "ARCHITECTURE.md").read_text()
    shown = page.split("<!-- imports -->")[1].split("<!-- /imports -->")[0].strip()
    assert shown == table, f"put this table between the marks of ARCHITECTURE.md:\n{table}"


def test_no_modules_import_each_other_in_a_circle() -> None:
    found = {name_of(path): imports(path).when_loaded for package in PACKAGES for path in paths(package)}
    order = TopologicalSorter({name: names & found.keys() for name, names in found.items()})
    order.prepare()


@pytest.mark.parametrize(
    ("package", "folders"), [("server", {"gateway", "graph", "moveit"}), ("server.moveit", {"scene"})]
)
def test_no_folders_of_a_package_import_each_other_in_a_circle(package: str, folders: set[str]) -> None:
    """A module of server/ beside the folders counts as a folder of its own, modules of server/moveit/ as one together.

    Imports for type checking alone count as well.
    """
    found: dict[str, set[str]] = defaultdict(set)
    for path in paths(package.replace(".", "/")):
        names = imports(path).names | imports(path).sources
        found[folder_of(name_of(path), package)] |= {
            folder_of(name, package) for name in names if name.startswith(package + ".")
        }
    assert {f"{package}.{folder}" for folder in folders} <= found.keys()
    order = TopologicalSorter({folder: others - {folder, package} for folder, others in found.items()})
    order.prepare()


def folder_of(name: str, package: str) -> str:
    """Return the folder of a package that a module is in; beside them the module itself, or "modules"."""
    inner = name.removeprefix(f"{package}.").split(".")
    if package != "server" and not (ROOT / package.replace(".", "/") / inner[0]).is_dir():
        return f"{package}.modules"
    return f"{package}.{inner[0]}"


def test_the_gateway_knows_nothing_of_moveit() -> None:
    found = importing(["server"], lambda name, _package: name.startswith("server.moveit"))
    assert [each for each in found if each.startswith("server/gateway/")] == []


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
        name_of(path): imported_by(path)
        for package in (*PACKAGES, "tests", "harness")
        for path in paths(package, "[!_]*.py")
    }
    missed: set[str] = set()
    for folder in sorted({path.parent.relative_to(ROOT) for package in PACKAGES for path in paths(package)}):
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
        "tests/test_imports.py"
    )


def test_tests_and_benchmarks_import_nothing_of_each_other() -> None:
    known = {name_of(path) for package in HELPED for path in paths(package)}
    foreign, missing = [], []
    for package in HELPED:
        for path in paths(package):
            for name in imports(path).sources:
                place = f"{path.relative_to(ROOT)} imports {name}"
                foreign += [place] if name.split(".")[0] in {"tests", "benchmarks"} - {package} else []
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
