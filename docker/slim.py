"""Takes out of an environment what a running server never loads: ``python3 slim.py /opt/armbridge``.

Only whole files go, and files that are copies of others become links to them. Nothing is stripped: what is loaded stays
as it was published.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

# Below cmeel.prefix: for who compiles against these libraries.
DEVELOPMENT = ("include", "lib/cmake", "lib/pkgconfig", "lib/**/*.a", "bin", "share/man")

# Below site-packages.
TESTS = ("**/tests", "**/test")
SOURCES = ("**/*.c", "**/*.cpp", "**/*.h", "**/*.hpp", "**/*.pxd", "**/*.pxi", "**/*.pyi", "**/*.pyx")
# What Python's own implementation never takes: it has backend_c.
OTHER_BACKENDS = ("zstandard/_cffi*.so",)
# Of scipy, the planners import spatial and sparse, which import linalg, special and constants.
SCIPY = ("cluster", "fft", "integrate", "interpolate", "io", "ndimage", "optimize", "signal", "stats")


def main(arguments: list[str]) -> int:
    """Slim the environment and tell what each step has saved."""
    (packages,) = Path(arguments[0]).glob("lib/python3*/site-packages")
    prefix = packages / "cmeel.prefix"
    before_bytes = size_bytes(packages)
    _tell("headers, static libraries, compilers' tools", remove(_found(prefix, DEVELOPMENT)))
    _tell("copies of libraries", link_copies(prefix / "lib"))
    _tell("tests of packages", remove(_found(packages, TESTS)))
    _tell("sources and stubs of compiled modules", remove(_found(packages, SOURCES)))
    _tell("backends for other Pythons", remove(_found(packages, OTHER_BACKENDS)))
    _tell("modules of scipy", remove(_found(packages, [f"scipy/{name}" for name in SCIPY])))
    _tell("in all", before_bytes - size_bytes(packages))
    return 0


def size_bytes(root: Path) -> int:
    """What a file, or all files in a directory, take; links are not followed."""
    if root.is_symlink() or not root.is_dir():
        return root.lstat().st_size
    return sum(size_bytes(each) for each in root.iterdir())


def remove(paths: Iterable[Path]) -> int:
    """Remove files and directories; returns how many bytes they took."""
    saved_bytes = 0
    for path in paths:
        saved_bytes += size_bytes(path)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    return saved_bytes


def link_copies(directory: Path) -> int:
    """Turn files with the same content in one directory into links to one of them.

    A wheel holds no links, so each library is in it under each of its names.

    Returns:
        How many bytes that saves.
    """
    first: dict[bytes, Path] = {}
    saved_bytes = 0
    for path in sorted(directory.glob("*.so*")):
        if path.is_symlink():
            continue
        original = first.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
        if original != path:
            saved_bytes += remove([path])
            path.symlink_to(original.name)
    return saved_bytes


def _found(root: Path, patterns: Iterable[str]) -> Iterator[Path]:
    for pattern in patterns:
        # What lies within something that was found before is gone by then.
        yield from (path for path in sorted(root.glob(pattern)) if path.exists())


def _tell(what: str, saved_bytes: int) -> None:
    sys.stdout.write(f"{saved_bytes / 1e6:7.1f} MB  {what}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
