"""Keeps saved states in a JSON file: joint positions by state and joint [rad]."""

from __future__ import annotations

import asyncio
import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TypeAlias

from pydantic import BaseModel, ConfigDict, ValidationError

from robot.description.model import RobotModel
from server.errors import ServiceError

log = logging.getLogger("armbridge.named_states")

# A thousand states of a large robot; what comes after it in the file makes it invalid JSON.
MAX_FILE_BYTES = 10_000_000

# A memory card that takes longer is at its end.
WRITING_TIMEOUT_S = 5.0

States: TypeAlias = dict[str, dict[str, float]]


class _Content(BaseModel):
    model_config = ConfigDict(strict=True)

    states: States


def default_path(robot: RobotModel, environment: Mapping[str, str]) -> Path:
    """Where a robot's states are kept when no setting says otherwise: the XDG base directory for data.

    Args:
        robot: the arm, which gives the file its name.
        environment: environment variables.
    """
    data_home = environment.get("XDG_DATA_HOME") or str(
        Path(environment.get("HOME", "~")).expanduser() / ".local/share"
    )
    safe = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in robot.name)
    return Path(data_home) / "armbridge" / f"named_states_{safe}.json"


class NamedStatesFile:
    """The file.

    Args:
        path: where it is; made with the first state.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> States:
        """Read the states; a file that cannot be understood is set aside under another name, and told of."""
        try:
            with self._path.open("rb") as file:
                text = file.read(MAX_FILE_BYTES)
            return _Content.model_validate_json(text).states
        except FileNotFoundError:
            return {}
        except OSError as error:
            log.warning("saved states cannot be read from %s: %s", self._path, error)
        except ValidationError as error:
            first = error.errors()[0]
            self._set_aside(": ".join((*(str(part) for part in first["loc"]), first["msg"])))
        return {}

    async def save(self, states: Mapping[str, Mapping[str, float]]) -> None:
        """Write the states, so that a crash leaves the file as it was or as it shall be.

        Raises:
            ServiceError: they cannot be written.
        """
        try:
            await asyncio.wait_for(asyncio.to_thread(self._write, states), WRITING_TIMEOUT_S)
        except TimeoutError as error:
            raise ServiceError(f"{self._path} was not written within {WRITING_TIMEOUT_S:g} s") from error
        except OSError as error:
            raise ServiceError(f"the state cannot be kept in {self._path}: {error.strerror}") from error

    def _write(self, states: Mapping[str, Mapping[str, float]]) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        written = self._path.with_name(f"{self._path.name}.new")
        with written.open("w", encoding="utf-8") as file:
            json.dump({"states": states}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        written.replace(self._path)

    def _set_aside(self, reason: str) -> None:
        aside = self._path.with_name(f"{self._path.name}.broken")
        try:
            self._path.replace(aside)
        except OSError as error:
            log.warning("saved states in %s cannot be used: %s; nor set aside: %s", self._path, reason, error)
        else:
            log.warning("saved states in %s cannot be used: %s; the file is now %s", self._path, reason, aside)
