"""The modules of the program and of its tests as text: what they import, and what they say."""

import ast
import functools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from harness.server import ROOT

ROOMS = ("server", "planners", "robot", "protocol")


@dataclass(frozen=True)
class Imports:
    """Full names that a module imports.

    Attributes:
        names: all that it imports, anywhere in it.
        sources: modules that it imports names from.
        when_loaded: what it imports from modules, and these, when it is loaded: not for types alone, nor in a function.
    """

    names: frozenset[str]
    sources: frozenset[str]
    when_loaded: frozenset[str]


def paths(folder: str, pattern: str = "*.py") -> list[Path]:
    """The modules of a folder and of all below it; the page is no Python."""
    return [path for path in sorted((ROOT / folder).rglob(pattern)) if "node_modules" not in path.parts]


def name_of(path: Path) -> str:
    """The full name of a module."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


@functools.cache
def imports(path: Path) -> Imports:
    tree = ast.parse(path.read_text())
    names, sources = set[str](), set[str]()
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= set(_names(node))
            sources.add(str(node.module))
    loaded = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    when_loaded = {str(node.module) for node in loaded} | {name for node in loaded for name in _names(node)}
    return Imports(frozenset(names), frozenset(sources), frozenset(when_loaded))


def sentences(path: Path) -> Iterator[str]:
    """The strings of a module as they are printed, with an ellipsis for each value."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield re.sub(r"%\.?\w*[sdgfr]|\{[\w:.]*\}", "…", node.value)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Every statement below a node; expressions, which are most of a module, import nothing."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for child in getattr(node, part, ()):
            yield child
            yield from _statements(child)


def _names(node: ast.ImportFrom) -> Iterator[str]:
    return (f"{node.module}.{alias.name}" for alias in node.names)
