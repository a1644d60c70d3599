"""JSON files that several servers may share; with names in one folder: taught motions, saved scenes."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeVar

from robot import files
from server.errors import ServiceError

# File names have up to 255 bytes; a letter takes up to four.
MAX_NAME_LENGTH = 50

# The name is the file's name too: no separators of paths, and no dot in front.
_NAME = re.compile(r"\w[\w .()+-]*")

# A memory card that takes longer is at its end.
TIMEOUT_S = 5.0

SUFFIX = ".json"

Result = TypeVar("Result")


async def in_thread(path: Path, failure: str, work: Callable[[], Result]) -> Result:
    """Do work that waits for the disk.

    Raises:
        ServiceError: it failed; its sentence begins with `failure`.
    """
    try:
        return await asyncio.wait_for(asyncio.to_thread(work), TIMEOUT_S)
    except TimeoutError as error:
        raise ServiceError(f"{failure} within {TIMEOUT_S:g} s: the disk does not answer") from error
    except OSError as error:
        raise ServiceError(f"{failure}: {path}: {error.strerror}") from error
    except ValueError as error:
        raise ServiceError(f"{failure}: {error}") from error


def read_json(path: Path, max_bytes: int) -> Any:
    """Return the content of a JSON file.

    Raises:
        ValueError: it is too large, or no JSON.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        text = file.read(max_bytes + 1)
    if len(text) > max_bytes:
        raise ValueError(f"it has more than {max_bytes} bytes")
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it nests too deep") from error


class NamedFiles:
    """Store of files by name. All methods but :meth:`path` and :meth:`in_thread` wait for the disk.

    They raise OSError, and ValueError with a sentence, which :meth:`in_thread` makes a ServiceError.

    Args:
        kind: word for one of the things in the files, in sentences.
    """

    def __init__(self, folder: Path, kind: str, max_files: int) -> None:
        self._folder = folder
        self._kind = kind
        self._max_files = max_files

    def path(self, name: str, field: str = "name") -> Path:
        """Return the file of a name.

        Raises:
            ServiceError: the name cannot be a file's name; `field` names it.
        """
        if len(name) > MAX_NAME_LENGTH or _NAME.fullmatch(name) is None or name != name.strip():
            limits = f"must be 1 to {MAX_NAME_LENGTH} letters, digits, blanks or any of _ . ( ) + -, a letter first"
            raise ServiceError(f"{field}: {limits}, not {name[:MAX_NAME_LENGTH]!r}")
        return self._folder / f"{name}{SUFFIX}"

    async def in_thread(self, failure: str, work: Callable[[], Result]) -> Result:
        """Do work that waits for the disk, as :func:`in_thread`."""
        return await in_thread(self._folder, failure, work)

    def names(self) -> list[str]:
        """Return the names of the files, in alphabetical order."""
        return sorted(path.name.removesuffix(SUFFIX) for path in self._folder.glob(f"[!.]*{SUFFIX}"))

    def check_new(self, path: Path) -> None:
        """Check that there is no such file, and room for one."""
        if path.exists():
            raise ValueError(f"there is a {self._kind} of this name: delete or rename it, or choose another name")
        self._check_count(path)

    def write(self, path: Path, content: bytes) -> None:
        """Write a file, in place of one of the same name; a crash leaves the old content or the new one."""
        # The lock of the folder, so that two servers do not both write the last file.
        with self._locked():
            self._check_count(path)
            files.replace(path, content)

    def read(self, path: Path, read: Callable[[Path], Result]) -> Result:
        """Return what a function reads from a file."""
        try:
            return read(path)
        except FileNotFoundError:
            raise self._unknown() from None

    def delete(self, path: Path) -> None:
        """Delete a file."""
        self.read(path, Path.unlink)

    def rename(self, path: Path, new_path: Path) -> None:
        """Rename a file; no other is replaced."""
        with self._locked():
            if new_path.exists():
                raise ValueError(f"there is a {self._kind} {new_path.name.removesuffix(SUFFIX)!r} already")
            self.read(path, lambda old: old.rename(new_path))

    def _locked(self) -> AbstractContextManager[None]:
        return files.locked(self._folder / f"{self._kind}s")

    def _check_count(self, path: Path) -> None:
        others = [name for name in self.names() if name != path.name.removesuffix(SUFFIX)]
        if len(others) >= self._max_files:
            raise ValueError(f"{len(others)} {self._kind}s are saved already, the limit is {self._max_files}")

    def _unknown(self) -> ValueError:
        known = ", ".join(self.names())
        return ValueError(f"there is none of this name; saved are: {known}" if known else f"no {self._kind} is saved")
