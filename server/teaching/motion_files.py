"""Taught motions by name: each is a JSON file of its own in one folder, which several servers may share."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robot.description.model import RobotModel
from server.moveit.trajectories import MAX_POINTS
from server.named_files import NamedFiles
from server.teaching.taught_motion import MAX_DURATION_S, TaughtMotion

# As many as a list shows that people read.
MAX_MOTIONS = 100

# The points of forty joints as text; of six joints they have 0.8 MB.
MAX_FILE_BYTES = 8_000_000


class _Content(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    joint_names: list[str] = Field(min_length=1)
    time_s: list[float] = Field(min_length=2, max_length=MAX_POINTS)
    positions_rad: list[list[float]]


class MotionFiles(NamedFiles):
    """Store of motions by name."""

    def __init__(self, folder: Path, robot: RobotModel) -> None:
        super().__init__(folder, "motion", MAX_MOTIONS)
        self._robot = robot

    async def load(self, name: str) -> TaughtMotion:
        """Return a motion."""
        return await self.read(name, self._read)

    async def save(self, name: str, motion: TaughtMotion) -> None:
        """Save a motion, in place of one of the same name."""

        def content() -> bytes:
            fields = {
                "joint_names": list(motion.joint_names),
                "time_s": motion.time_s.tolist(),
                "positions_rad": motion.positions_rad.tolist(),
            }
            text = json.dumps(fields, separators=(",", ":")).encode()
            if len(text) > MAX_FILE_BYTES:
                raise ValueError(f"it has {len(text)} bytes as a file, the limit is {MAX_FILE_BYTES}")
            return text

        await self.write(name, content)

    def _read(self, path: Path) -> TaughtMotion:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1)
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
