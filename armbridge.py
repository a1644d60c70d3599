"""The command ``armbridge``, before it imports the packages ``server``, ``planners``, ``robot`` and ``protocol``.

Other distributions have packages of these names as well; the command then ends with the name of the distribution.
"""

from __future__ import annotations

import os
import sys
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

PACKAGES = ("server", "planners", "robot", "protocol")

REMEDY = "install armbridge in an environment of its own (docs/install.md)"


def main() -> NoReturn:
    """Run the command and end the process with its exit code."""
    if shadowed := find_shadowed(Path(__file__).parent):
        sys.exit(f"armbridge: {shadowed}; {REMEDY}")
    # Before numpy is loaded: a thread of the linear algebra library would be in no fork, and costs more than it saves
    # for matrices as small as ours (the import of a UR5 takes 34 s, with two threads 50 s on two cores).
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    try:
        from server.cli import run_process
    except ImportError as error:
        # Files of two distributions in one folder: whichever was installed last has overwritten the other's.
        if overwritten := find_overwritten():
            sys.exit(f"armbridge: {overwritten}; {REMEDY} ({error})")
        raise
    except KeyboardInterrupt:
        sys.exit("armbridge: stopped")
    run_process()


def find_shadowed(home: Path) -> str | None:
    """Return a sentence about the first package that Python would not take from a folder, None if there is none.

    Args:
        home: folder that contains armbridge's own packages.
    """
    for package in PACKAGES:
        spec = find_spec(package)
        file = None if spec is None else spec.origin
        if file is None or Path(file).parent.parent.resolve() != home.resolve():
            return f"the package {package}{_owners(package)} in {file} is in the way of armbridge's own"
    return None


def find_overwritten() -> str | None:
    """Return a sentence about the first package that another distribution has files in, None if there is none."""
    return next(
        (
            f"the package {package}{owners} is mixed with armbridge's own"
            for package in PACKAGES
            if (owners := _owners(package))
        ),
        None,
    )


def _owners(package: str) -> str:
    """Return the other distributions with a package of this name, as `` of robotframework 7.0``."""
    names = {name for name in metadata.packages_distributions().get(package, ()) if name != "armbridge"}
    return f" of {', '.join(f'{name} {metadata.version(name)}' for name in sorted(names))}" if names else ""


if __name__ == "__main__":
    main()
