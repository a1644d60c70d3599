"""Taught motions by name: each is a JSON file of its own in one folder, which several servers may share."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robot import files
from robot.description.model import RobotModel
from server.errors import ServiceError
from server.moveit.requests.trajectories import MAX_POINTS
from server.teaching.taught_motion import MAX_DURATION_S, TaughtMotion

# As many as a list shows that people read.
MAX_MOTIONS = 100

# The points of forty joints as text; of six joints they have 0.8 MB.
MAX_FILE_BYTES = 8_000_000

# File names have up to 255 bytes, of which a letter takes up to four.
MAX_NAME_LENGTH = 50

# The name is that of the file too: no separators of paths, and no dot in front.
_NAME = re.compile(r"\w[\w .()+-]*")

# A memory card that takes longer is at its end.
TIMEOUT_S = 5.0

SUFFIX = ".json"

Result = TypeVar("Result")


class _Content(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    joint_names: list[str] = Field(min_length=1)
    time_s: list[float] = Field(min_length=2, max_length=MAX_POINTS)
    positions_rad: list[list[float]]


class MotionFiles:
    """Store of motions by name.

    Args:
        folder: of the files; created with the first motion.
        robot: the arm.
    """

    def __init__(self, folder: Path, robot: RobotModel) -> None:
        self._folder = folder
        self._robot = robot

    async def names(self) -> list[str]:
        """Return the names of the motions, in alphabetical order.

        Raises:
            ServiceError: the folder cannot be read.
        """
        return await self._in_thread("the taught motions cannot be listed", self._names)

    async def load(self, name: str) -> TaughtMotion:
        """Return a motion.

        Raises:
            ServiceError: there is none of this name, or its file cannot be used.
        """
        path = self._path(name)
        return await self._in_thread(f"the motion {name!r} cannot be read", lambda: self._read(path))

    async def check_new(self, name: str) -> None:
        """Check that a motion can be saved under a name that is not taken.

        Raises:
            ServiceError: it cannot; the sentence says what to do.
        """
        path = self._path(name)
        await self._in_thread(f"the motion {name!r} cannot be recorded", lambda: self._check_free(path))

    async def save(self, name: str, motion: TaughtMotion) -> None:
        """Save a motion, in place of one of the same name.

        Raises:
            ServiceError: the name is invalid, there are too many motions, or the file cannot be written.
        """
        path = self._path(name)
        await self._in_thread(f"the motion {name!r} cannot be saved", lambda: self._write(path, motion))

    async def delete(self, name: str) -> None:
        """Delete a motion.

        Raises:
            ServiceError: there is none of this name, or its file cannot be deleted.
        """
        path = self._path(name)
        await self._in_thread(f"the motion {name!r} cannot be deleted", lambda: self._unlink(path))

    async def rename(self, name: str, new_name: str) -> None:
        """Rename a motion.

        Raises:
            ServiceError: there is none of this name, or the new name is taken or invalid.
        """
        path, new_path = self._path(name), self._path(new_name, "new_name")
        await self._in_thread(f"the motion {name!r} cannot be renamed", lambda: self._rename(path, new_path))

    def _path(self, name: str, field: str = "name") -> Path:
        if len(name) > MAX_NAME_LENGTH or _NAME.fullmatch(name) is None or name != name.strip():
            limits = f"must be 1 to {MAX_NAME_LENGTH} letters, digits, blanks or any of _ . ( ) + -, a letter first"
            raise ServiceError(f"{field}: {limits}, not {name[:MAX_NAME_LENGTH]!r}")
        return self._folder / f"{name}{SUFFIX}"

    def _names(self) -> list[str]:
        return sorted(path.name.removesuffix(SUFFIX) for path in self._folder.glob(f"[!.]*{SUFFIX}"))

    def _check_free(self, path: Path) -> None:
        if path.exists():
            raise ValueError("there is a motion of this name: delete or rename it, or choose another name")
        self._check_count(path)

    def _check_count(self, path: Path) -> None:
        others = [name for name in self._names() if name != path.name.removesuffix(SUFFIX)]
        if len(others) >= MAX_MOTIONS:
            raise ValueError(f"{len(others)} motions are saved already, the limit is {MAX_MOTIONS}")

    def _write(self, path: Path, motion: TaughtMotion) -> None:
        content = {
            "joint_names": list(motion.joint_names),
            "time_s": motion.time_s.tolist(),
            "positions_rad": motion.positions_rad.tolist(),
        }
        text = json.dumps(content, separators=(",", ":")).encode()
        if len(text) > MAX_FILE_BYTES:
            raise ValueError(f"it has {len(text)} bytes as a file, the limit is {MAX_FILE_BYTES}")
        # The lock of the folder, so that two servers do not both save the last motion.
        with files.locked(self._folder / "motions"):
            self._check_count(path)
            files.replace(path, text)

    def _read(self, path: Path) -> TaughtMotion:
        try:
            with path.open("rb") as file:
                text = file.read(MAX_FILE_BYTES + 1)
        except FileNotFoundError:
            raise self._unknown() from None
        try:
            content = _Content.model_validate_json(text)
        except ValidationError as error:
            raise ValueError(f"{path} holds no motion: {error.errors()[0]['msg']}") from None
        return self._motion(path, content)

    def _motion(self, path: Path, content: _Content) -> TaughtMotion:
        """Return the motion of a file, which people may have edited."""
        movable = {joint.name for joint in self._robot.movable_joints}
        names = tuple(content.joint_names)
        if not set(names) <= movable or len(set(names)) < len(names):
            raise ValueError(f"{path} is of the joints {', '.join(names)[:200]}, which are not all of this robot")
        if {len(point) for point in content.positions_rad} != {len(names)} or len(content.positions_rad) != len(
            content.time_s
        ):
            raise ValueError(f"{path} must have a point of {len(names)} joints for each of its times")
        time_s = np.array(content.time_s)
        if time_s[0] != 0.0 or np.any(np.diff(time_s) <= 0.0) or time_s[-1] > MAX_DURATION_S:
            raise ValueError(f"{path} must have times that increase from 0 to at most {MAX_DURATION_S:g} s")
        return TaughtMotion(names, time_s, np.array(content.positions_rad))

    def _unlink(self, path: Path) -> None:
        try:
            path.unlink()
        except FileNotFoundError:
            raise self._unknown() from None

    def _rename(self, path: Path, new_path: Path) -> None:
        with files.locked(self._folder / "motions"):
            if new_path.exists():
                raise ValueError(f"there is a motion {new_path.name.removesuffix(SUFFIX)!r} already")
            try:
                path.rename(new_path)
            except FileNotFoundError:
                raise self._unknown() from None

    def _unknown(self) -> ValueError:
        known = ", ".join(self._names())
        return ValueError(f"there is none of this name; saved are: {known}" if known else "no motion is saved")

    async def _in_thread(self, failure: str, work: Callable[[], Result]) -> Result:
        """Do what waits for the disk; errors become sentences."""
        try:
            return await asyncio.wait_for(asyncio.to_thread(work), TIMEOUT_S)
        except TimeoutError as error:
            raise ServiceError(f"{failure} within {TIMEOUT_S:g} s: the disk does not answer") from error
        except OSError as error:
            raise ServiceError(f"{failure}: {self._folder}: {error.strerror}") from error
        except ValueError as error:
            raise ServiceError(f"{failure}: {error}") from error
