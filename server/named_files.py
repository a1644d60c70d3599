"""Files that several servers may share: JSON, by name in one folder (taught motions, saved scenes), and series."""

import json
import re
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from robot import files
from server.disk import Disk
from server.errors import ServiceError

# File names have up to 255 bytes; a letter takes up to four.
MAX_NAME_LENGTH = 50

# The name is the file's name too: no separators of paths, and no dot in front.
_NAME = re.compile(r"\w[\w .()+-]*")

SUFFIX = ".json"

Result = TypeVar("Result")


def read_json(path: Path, max_bytes: int) -> Any:
    """Return the content of a JSON file, or raise ValueError or OSError."""
    with path.open("rb") as file:
        text = file.read(max_bytes + 1)
    if len(text) > max_bytes:
        raise ValueError(f"it has more than {max_bytes} bytes")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"it is no JSON: {error}") from error
    except RecursionError as error:
        raise ValueError("it nests too deep") from error


class NamedFiles:
    """Store of ``kind`` files by name, which several servers may share; its methods raise ServiceError."""

    def __init__(self, folder: Path, kind: str, max_files: int) -> None:
        self._folder = folder
        self._kind = kind
        self._max_files = max_files
        self._disk = Disk()

    async def names(self) -> list[str]:
        return await self._disk.serve(self._folder, f"the saved {self._kind}s cannot be listed", self._names)

    async def check_new(self, name: str) -> None:
        """Check that a file can be saved under a name that is not taken."""
        path = self._path(name)

        def check() -> None:
            # A folder that takes no lock, as on a full disk, would take no file in the end.
            with self._locked():
                if path.exists():
                    raise ValueError(f"there is a {self._kind} of this name: delete or rename it, or choose another")
                self._check_count(path)

        await self._in_thread(name, "recorded", check)

    async def write(self, name: str, content: Callable[[], bytes]) -> None:
        """Write a file in place of another, atomically; ``content`` is made in a thread, or raises ValueError."""
        path = self._path(name)

        def write() -> None:
            octets = content()
            # The lock of the folder, so that two servers do not both write the last file.
            with self._locked():
                self._check_count(path)
                files.replace(path, octets)

        await self._in_thread(name, "saved", write)

    async def read(self, name: str, read: Callable[[Path], Result], done: str = "read") -> Result:
        path = self._path(name)
        return await self._in_thread(name, done, lambda: self._known(path, read))

    async def delete(self, name: str) -> str:
        """Delete a file; return a sentence about it."""
        await self.read(name, Path.unlink, "deleted")
        return f"the {self._kind} {name!r} is deleted"

    async def list_for(self, _request: Mapping[str, Any]) -> dict[str, Any]:
        """Serve the names of all files."""
        return {"names": await self.names()}

    def delete_for(self, request: Mapping[str, Any]) -> Awaitable[str]:
        """Serve the deletion of the file with the name in a request."""
        return self.delete(request["name"])

    async def rename(self, name: str, new_name: str) -> None:
        """Rename a file; no other is replaced."""
        path, new_path = self._path(name), self._path(new_name, "new_name")

        def rename() -> None:
            with self._locked():
                if new_path.exists():
                    raise ValueError(f"there is a {self._kind} {new_name!r} already")
                self._known(path, lambda old: old.rename(new_path))

        await self._in_thread(name, "renamed", rename)

    async def _in_thread(self, name: str, done: str, work: Callable[[], Result]) -> Result:
        return await self._disk.serve(self._folder, f"the {self._kind} {name!r} cannot be {done}", work)

    def _path(self, name: str, field: str = "name") -> Path:
        """Return the file of a name; `field` names the name in refusals."""
        if len(name) > MAX_NAME_LENGTH or _NAME.fullmatch(name) is None or name != name.strip():
            limits = f"must be 1 to {MAX_NAME_LENGTH} letters, digits, blanks or any of _ . ( ) + -, a letter first"
            raise ServiceError(f"{field}: {limits}, not {name[:MAX_NAME_LENGTH]!r}")
        return self._folder / f"{name}{SUFFIX}"

    def _names(self) -> list[str]:
        return sorted(path.name.removesuffix(SUFFIX) for path in self._folder.glob(f"[!.]*{SUFFIX}"))

    def _known(self, path: Path, use: Callable[[Path], Result]) -> Result:
        try:
            return use(path)
        except FileNotFoundError:
            known = ", ".join(self._names())
            text = f"there is no such {self._kind}; saved are: {known}" if known else f"no {self._kind} is saved"
            raise ValueError(text) from None

    def _locked(self) -> AbstractContextManager[None]:
        return files.locked(self._folder / f"{self._kind}s")

    def _check_count(self, path: Path) -> None:
        others = [name for name in self._names() if name != path.name.removesuffix(SUFFIX)]
        if len(others) >= self._max_files:
            raise ValueError(f"{len(others)} {self._kind}s are saved already, the limit is {self._max_files}")


@dataclass(frozen=True)
class FileSeries:
    """Directory of files; the oldest make room for new ones. Names must sort by age between prefix and suffix."""

    directory: Path
    prefix: str
    suffix: str
    max_files: int

    def add(self, name: str, content: Callable[[], bytes]) -> Path:
        """Write a file; a crash, and an OSError, leave all of it or nothing.

        The name stands between prefix and suffix; a number is added when there is such a file.
        """
        # A file of this name in the directory stands for its lock.
        with files.locked(self.directory / self.prefix.rstrip("-")):
            path, number = self.directory / f"{self.prefix}{name}{self.suffix}", 0
            while path.exists():
                number += 1
                path = self.directory / f"{self.prefix}{name}-{number}{self.suffix}"
            files.replace(path, content())
            # The new one stays also where its name is not the last: the clock that names it may be set back.
            others = [each for each in self.paths() if each != path]
            for oldest in others[: max(len(others) + 1 - self.max_files, 0)]:
                oldest.unlink(missing_ok=True)
        return path

    def paths(self) -> list[Path]:
        return sorted(self.directory.glob(f"{self.prefix}*{self.suffix}"))


def set_aside(path: Path) -> Path:
    """Rename a file that cannot be used, whose lock is held, to ``NAME.broken``, ``NAME.broken.1`` and so on."""
    aside, number = path.with_name(f"{path.name}.broken"), 0
    while aside.exists():
        number += 1
        aside = path.with_name(f"{path.name}.broken.{number}")
    path.replace(aside)
    return aside
