"""toppra without the libraries that it needs for other things than timing.

Its package imports scipy.interpolate, scipy.sparse and matplotlib.pyplot for its splines, a solver and plots. They
take nearly all of its import, most of a second, and 65 MB in every planner process. So empty modules stand in for them
while it is imported.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

_UNUSED = ("scipy", "scipy.interpolate", "scipy.sparse", "matplotlib", "matplotlib.pyplot")


class _Unused(ModuleType):
    """Module of which any name can be imported, and nothing used."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        # Python takes a module without a path for one that has no modules in it.
        self.__path__ = []

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


@contextmanager
def _without(names: tuple[str, ...]) -> Iterator[None]:
    """Have empty modules stand in for those that are not loaded, as long as the body runs."""
    absent = [name for name in names if name not in sys.modules]
    sys.modules.update({name: _Unused(name) for name in absent})
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


# Python 3.12 and later warn of the LaTeX in its docstrings wherever they compile it.
with _without(_UNUSED), warnings.catch_warnings(action="ignore"):
    for module in ("toppra", "toppra.algorithm", "toppra.constraint"):
        importlib.import_module(module)

from toppra.algorithm import TOPPRA  # noqa: E402
from toppra.constraint import (  # noqa: E402
    DiscretizationType,
    JointAccelerationConstraint,
    JointVelocityConstraintVarying,
)

__all__ = ["TOPPRA", "DiscretizationType", "JointAccelerationConstraint", "JointVelocityConstraintVarying"]
