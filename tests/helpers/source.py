"""The modules of the program and of its tests as text: what they import, and what they say."""

import ast
import functools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from harness.server import ROOT

PACKAGES = ("server", "planners", "robot", "protocol")


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


# To parse whole modules takes twelve times as long.
_IMPORT = re.compile(r"^( *)((?:from [\w.]+ )?import (?:\([^)]*\)|[^\n]*))", re.MULTILINE)


@functools.cache
def imports(path: Path) -> Imports:
    """Return the imports of a module, and of the programs in its strings."""
    names, sources, when_loaded = set[str](), set[str](), set[str]()
    for indentation, statement in _IMPORT.findall(path.read_text()):
        (node, *_) = ast.parse(statement).body
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            imported = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= imported
            sources.add(str(node.module))
            when_loaded |= set() if indentation else {str(node.module), *imported}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return Imports(frozenset(names), frozenset(sources), frozenset(when_loaded))


def sentences(path: Path) -> Iterator[str]:
    """The strings of a module as they are printed, with an ellipsis for each value."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield re.sub(r"%\.?\w*[sdgfr]|\{[\w:.]*\}", "…", node.value)
