"""Named states: those of the SRDF, and those that people save; what a named goal goes to."""

from __future__ import annotations

import asyncio
import difflib
import math
from collections.abc import Awaitable, Callable, Mapping
from typing import TypeAlias

from robot.description.model import RobotModel
from server.errors import ServiceError

# Joint name -> position [rad].
Positions: TypeAlias = Mapping[str, float]

# More than anyone tells apart by name; the file stays small enough to be written within milliseconds.
MAX_STATES = 1000
MAX_NAME_LENGTH = 100

# Names less alike than this are not what somebody meant.
LEAST_LIKENESS = 0.6


class NamedStates:
    """The states by name; case and blanks of names do not matter.

    Args:
        robot: the arm; its SRDF's states cannot be changed.
        group: planning group whose states of the SRDF count.
        saved: those saved before, name -> positions.
        keep: keeps all that are saved, after every change.
    """

    def __init__(
        self,
        robot: RobotModel,
        group: str,
        saved: Mapping[str, Positions],
        keep: Callable[[Mapping[str, Positions]], Awaitable[None]],
    ) -> None:
        self._joints = {joint.name: joint for joint in robot.movable_joints}
        self._described: dict[str, Positions] = dict(robot.named_states.get(group, {}))
        self._keep = keep
        self._changing = asyncio.Lock()
        self._listeners: list[Callable[[], None]] = []
        self._saved: dict[str, Positions] = {}
        for name, positions_rad in saved.items():
            if self._refusal(name, positions_rad) is None:
                self._saved[name] = dict(positions_rad)

    @property
    def described(self) -> Mapping[str, Positions]:
        """The states of the SRDF."""
        return self._described

    @property
    def saved(self) -> Mapping[str, Positions]:
        """The states that people saved."""
        return self._saved

    @property
    def names(self) -> list[str]:
        """All names, in alphabetical order."""
        return sorted((*self._described, *self._saved))

    def find(self, name: str) -> tuple[str, Positions] | None:
        """The state of this name, and how the name is spelled; None when there is none."""
        for states in (self._described, self._saved):
            for spelled, positions_rad in states.items():
                if _key(spelled) == _key(name):
                    return spelled, positions_rad
        return None

    def nearest_name(self, name: str) -> str | None:
        """The name that is most like one that does not exist, None when none is."""
        by_key = {_key(known): known for known in self.names}
        alike = difflib.get_close_matches(_key(name), by_key, 1, LEAST_LIKENESS)
        return by_key[alike[0]] if alike else None

    def on_change(self, listener: Callable[[], None]) -> None:
        """Have this called after every change."""
        self._listeners.append(listener)

    async def save(self, name: str, positions_rad: Positions) -> None:
        """Keep a state, in place of one of the same name.

        Raises:
            ServiceError: a name or position that cannot be kept, named with its limit.
        """
        spelled = " ".join(name.split())
        refusal = self._refusal(spelled, positions_rad)
        if refusal is not None:
            raise ServiceError(refusal)
        async with self._changing:
            others = {known: state for known, state in self._saved.items() if _key(known) != _key(spelled)}
            if len(others) >= MAX_STATES:
                raise ServiceError(f"name: {len(others)} states are saved already, the limit is {MAX_STATES}")
            await self._change({**others, spelled: dict(positions_rad)})

    async def delete(self, name: str) -> None:
        """Forget a state.

        Raises:
            ServiceError: no such state, or one of the SRDF.
        """
        async with self._changing:
            spelled, _ = self._own(name)
            await self._change({known: state for known, state in self._saved.items() if known != spelled})

    async def rename(self, old_name: str, new_name: str) -> None:
        """Give a state another name.

        Raises:
            ServiceError: no such state, one of the SRDF, or a name that is taken or cannot be had.
        """
        async with self._changing:
            spelled, positions_rad = self._own(old_name)
            taken = self.find(new_name)
            if taken is not None and taken[0] != spelled:
                raise ServiceError(f"new_name: there is a state {taken[0]!r} already")
            refusal = self._refusal(new := " ".join(new_name.split()), positions_rad)
            if refusal is not None:
                raise ServiceError(refusal)
            await self._change({new if known == spelled else known: state for known, state in self._saved.items()})

    def _own(self, name: str) -> tuple[str, Positions]:
        """A saved state, to be changed."""
        found = self.find(name)
        if found is None:
            raise ServiceError(f"name: there is no state {name!r}; known are: {', '.join(self.names)}")
        if found[0] in self._described:
            raise ServiceError(f"name: {found[0]!r} is a state of the SRDF, which is not changed here")
        return found

    async def _change(self, saved: dict[str, Positions]) -> None:
        await self._keep(saved)
        self._saved = saved
        for listener in self._listeners:
            listener()

    def _refusal(self, name: str, positions_rad: Positions) -> str | None:
        """Why a state cannot be kept under a name, or None."""
        if not 1 <= len(name) <= MAX_NAME_LENGTH or not name.isprintable():
            return f"name: must have 1 to {MAX_NAME_LENGTH} printable characters, not {name[:MAX_NAME_LENGTH]!r}"
        if any(_key(described) == _key(name) for described in self._described):
            return f"name: {name!r} is a state of the SRDF, which is not changed here"
        if not positions_rad:
            return "state: names no joint of the robot"
        for joint_name, position_rad in positions_rad.items():
            joint = self._joints.get(joint_name)
            if joint is None:
                return f"state: the robot has no joint {joint_name!r}; it has {', '.join(self._joints)}"
            if not math.isfinite(position_rad):
                return f"state: the position of joint {joint_name} must be a finite number, not {position_rad}"
        return None


def _key(name: str) -> str:
    return "".join(name.split()).casefold()
