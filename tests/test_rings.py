"""Limits of a test of the first ring: no fixed time, no duration, one server a module (ARCHITECTURE.md)."""

import ast
from pathlib import Path

ROOT = Path(__file__).parent
OTHER_RINGS = ("processes", "page", "clients", "examples", "lerobot", "fuzz", "helpers", "docker")
CLOCKS = {"time.monotonic", "time.perf_counter", "time.time", "time.process_time", "time.monotonic_ns"}
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
            if not stepped(tree, around) and not any(isinstance(node, ast.While) for node in around):
                found.append(f"{name}:{call.lineno}")
    assert found == [], f"in tests/: wait for an event (harness/waiting.py), or {ELSEWHERE}"


def test_nobody_measures_how_long_something_takes() -> None:
    """A clock may be read to be passed on, but no time is taken from it but a fixed one."""
    found = []
    for name, tree in modules(*CLOCKS):
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.BinOp)
                and isinstance(node.op, ast.Sub)
                and not isinstance(node.right, ast.Constant)
            ):
                called = {name_of(each.func) for each in ast.walk(node) if isinstance(each, ast.Call)}
                found += [f"{name}:{node.lineno}"] if called & CLOCKS else []
    assert found == [], f"in tests/: step the clock (tests/helpers/clock.py), or {ELSEWHERE}"


def test_a_module_starts_one_server_at_most() -> None:
    found = {name: sum(called in SERVERS for called, _, _ in calls(tree)) for name, tree in modules(*SERVERS)}
    several = {name: count for name, count in found.items() if count > 1}
    assert several == {}, f"in tests/: share one server by a fixture of the module, or {ELSEWHERE}"
