"""toppra without the libraries that it needs for other things than timing.

Its package imports scipy.interpolate, scipy.sparse and matplotlib.pyplot for its splines, a solver and plots. With them
a planner process takes 165 MB in place of 84 MB and 0.7 s longer to start, so empty modules stand in for them during
the import; matplotlib need not be installed.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from types import ModuleType
from typing import Any

_UNUSED = ("scipy", "scipy.interpolate", "scipy.sparse", "matplotlib", "matplotlib.pyplot")


class _Unused(ModuleType):
    """Module that any name can be imported from, and nothing used."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        # Python imports nothing from within a module without a path.
        self.__path__ = []

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


_absent = [name for name in _UNUSED if name not in sys.modules]
sys.modules.update({name: _Unused(name) for name in _absent})
try:
    # Python 3.12 and later warn of the LaTeX in its docstrings wherever they compile it.
    with warnings.catch_warnings(action="ignore"):
        for module in ("toppra", "toppra.algorithm", "toppra.constraint"):
            importlib.import_module(module)
finally:
    for name in _absent:
        del sys.modules[name]

from toppra.algorithm import TOPPRA  # noqa: E402
from toppra.constraint import (  # noqa: E402
    DiscretizationType,
    JointAccelerationConstraint,
    JointVelocityConstraintVarying,
)

__all__ = ["TOPPRA", "DiscretizationType", "JointAccelerationConstraint", "JointVelocityConstraintVarying"]
