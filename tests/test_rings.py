"""Limits of a test of the first ring: no fixed time, no duration, one server a module (ARCHITECTURE.md)."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parent
# The folders that `make test` leaves out, and the one that all rings share.
OTHER_RINGS = {*re.findall(r"--ignore tests/(\w+)", (ROOT.parent / "Makefile").read_text()), "helpers"}
# Last parts of their names: `time` is also that of an event loop.
CLOCKS = {"monotonic", "perf_counter", "process_time", "thread_time", "time", "monotonic_ns", "perf_counter_ns"}
WAITS = {"wait", "wait_for", "timeout", "settimeout", "communicate", "create_connection", "join", "select"}
ELSEWHERE = "move the test to the same folder of tests/processes/ (ARCHITECTURE.md)"
SERVERS = {"RunningServer", "server_on_bus"}


def modules(*words: str) -> list[tuple[str, ast.Module]]:
    """The modules of the first ring with any of these words; the others need not be parsed."""
    names = (path.relative_to(ROOT) for path in sorted(ROOT.rglob("*.py")))
    texts = {str(name): (ROOT / name).read_text() for name in names if name.parts[0] not in OTHER_RINGS}
    return [(name, ast.parse(text)) for name, text in texts.items() if any(word in text for word in words)]


def name_of(called: ast.expr) -> str:
    """Return ``a.b.c`` as it is written; empty for what has no name. A tenth of the time of ``ast.unparse``."""
    if isinstance(called, ast.Attribute):
        return f"{name_of(called.value)}.{called.attr}"
    return called.id if isinstance(called, ast.Name) else ""


def last_name(called: ast.expr) -> str:
    return called.attr if isinstance(called, ast.Attribute) else name_of(called)


def is_number(value: ast.expr) -> bool:
    """Tell whether a time is written as a number, or as a number of times another; 0 waits for nothing."""
    if isinstance(value, ast.BinOp):
        sides = (value.left, value.right)
        fixed = all(isinstance(side, ast.Constant | ast.Name) and name_of(side) != "TIMEOUT_S" for side in sides)
        return fixed and any(map(is_number, sides))
    return isinstance(value, ast.Constant) and isinstance(value.value, int | float) and value.value > 0


def calls(module: ast.Module) -> list[tuple[str, ast.Call, list[ast.AST]]]:
    """Every call by the name that it is called by, with what stands around it, innermost last."""
    found = []

    def visit(node: ast.AST, around: list[ast.AST]) -> None:
        if isinstance(node, ast.Call):
            found.append((name_of(node.func), node, around))
        inside = [*around, node]
        for child in ast.iter_child_nodes(node):
            visit(child, inside)

    visit(module, [])
    return found


def stepped(tree: ast.Module, around: list[ast.AST]) -> bool:
    """Tell whether the mark ``stepped_time`` is on the module, or on a test around a place."""
    marked = [
        node for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
    ]
    functions = [each for node in around if isinstance(node, ast.AsyncFunctionDef) for each in node.decorator_list]
    return any("stepped_time" in ast.unparse(each) for each in (*marked, *functions))


def test_nobody_sleeps_for_a_fixed_time() -> None:
    """A sleep is one step of a loop that waits for something, or takes none of the machine's time."""
    found = []
    for name, tree in modules("sleep("):
        for called, call, around in calls(tree):
            if called not in ("asyncio.sleep", "time.sleep", "sleep") or ast.unparse(call.args[0]) in ("0", "0.0"):
                continue
            waits = any(isinstance(node, ast.While) and not of_clock(node.test, set()) for node in around)
            if not stepped(tree, around) and not waits:
                found.append(f"{name}:{call.lineno}")
    assert found == [], f"in tests/: wait for an event (harness/waiting.py), or {ELSEWHERE}"


def of_clock(node: ast.AST, kept: set[str]) -> bool:
    """Tell whether a part of a node is a reading of a clock, or a name that has one."""
    return any(
        name_of(each) in kept or (isinstance(each, ast.Call) and not each.args and last_name(each.func) in CLOCKS)
        for each in ast.walk(node)
        if isinstance(each, ast.expr)
    )


def test_nobody_measures_how_long_something_takes() -> None:
    """A clock may be read to be passed on, but no time is taken from it but a fixed one, and none is asserted."""
    found = set()
    for name, tree in modules(*(f"{clock}(" for clock in CLOCKS)):
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef) or stepped(tree, [function]):
                continue
            nodes = list(ast.walk(function))
            assigned = [node for node in nodes if isinstance(node, ast.Assign) and of_clock(node.value, set())]
            kept = {target.id for node in assigned for target in node.targets if isinstance(target, ast.Name)}
            asserted = {each for node in nodes if isinstance(node, ast.Assert) for each in ast.walk(node)}
            for node in nodes:
                if isinstance(node, ast.BinOp) and (
                    (isinstance(node.op, ast.Sub) and not isinstance(node.right, ast.Constant)) or node in asserted
                ):
                    found |= {f"{name}:{node.lineno}"} if of_clock(node, kept) else set()
    assert found == set(), f"in tests/: step the clock (tests/helpers/clock.py), or {ELSEWHERE}"


def test_only_a_broken_program_meets_the_end_of_a_wait() -> None:
    found = []
    for name, tree in modules(*(f"{wait}(" for wait in WAITS)):
        for called, call, around in calls(tree):
            # A rig's time is stepped.
            if last_name(call.func) not in WAITS or called.startswith("rig.") or stepped(tree, around):
                continue
            seconds = [*call.args, *(each.value for each in call.keywords if "timeout" in (each.arg or ""))]
            if any(is_number(each) for each in seconds):
                found.append(f"{name}:{call.lineno}")
    assert found == [], f"in tests/: wait for TIMEOUT_S (harness/waiting.py), or {ELSEWHERE}"


def test_a_module_starts_one_server_at_most() -> None:
    """The servers that modules share are started for all, and a test's own only where no other test has one."""
    found = {}
    for name, tree in modules(*SERVERS):
        functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        count = 0
        for called, _, around in calls(tree):
            if called in SERVERS:
                (maker,) = [node for node in around if node in functions][-1:]
                several = "parametrize" in ast.unparse(maker) or any(isinstance(node, ast.For) for node in around)
                users = [each for each in functions if maker.name in {arg.arg for arg in each.args.args}]
                shared = any("scope=" in ast.unparse(each) for each in maker.decorator_list)
                count += 2 if several else len(users) if users and not shared else 1
        if count > 1:
            found[name] = count
    assert found == {}, f"in tests/: share one server by a fixture of the module, or {ELSEWHERE}"
