"""Named states of the SRDF and of users: their store, their file, and their services.

The services have the names and types of moveit_ros_warehouse's node warehouse_services.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import logging
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import BaseModel, ConfigDict, ValidationError

from protocol.errors import shorten
from robot import files
from robot.description.model import RobotModel
from server.disk import Disk
from server.errors import ServiceError
from server.execution.monitors import CurrentState
from server.execution.motions import Positions
from server.graph.permissions import CONFIGURING, LOOKING, Rule
from server.graph.services import Answered, ServiceFunction
from server.graph.topics import Graph
from server.moveit.messages import Message
from server.named_files import read_json, set_aside

log = logging.getLogger("armbridge.named_states")

# More than users can distinguish by name; the file stays small enough to be written within milliseconds.
MAX_STATES = 1000
MAX_NAME_LENGTH = 100

# Names less alike than this are no slips.
MIN_SIMILARITY = 0.6

# A thousand states of a large robot.
MAX_FILE_BYTES = 10_000_000

NAMED_STATES_TOPIC = "/named_states"

States: TypeAlias = dict[str, dict[str, float]]

# Returns all saved states after a change of those before; raises ServiceError when they cannot be changed so.
Change: TypeAlias = Callable[[States], States]


class NamedStates:
    """Store of states by name, whose case and blanks do not matter; wrong changes raise ServiceError.

    There are ``described`` states of the SRDF, for one planning group, and states that users ``saved``, in a JSON file:
    joint positions by state and joint [rad]. Several servers may share the file.
    """

    def __init__(self, robot: RobotModel, group: str, path: Path) -> None:
        self._joints = {joint.name: joint for joint in robot.movable_joints}
        self._states_of_groups = robot.named_states
        self.described: Mapping[str, Positions] = robot.named_states.get(group, {})
        self._path = path
        self._disk = Disk()
        self._listeners: list[Callable[[], None]] = []
        self.saved = self._usable(self._load())

    def names(self, group: str | None = None) -> list[str]:
        """Return the names of all states in alphabetical order; as :meth:`find`."""
        return sorted(self._of(group))

    def select_group(self, group: str) -> None:
        """Choose the planning group whose states of the SRDF count."""
        self.described = self._states_of_groups.get(group, {})
        self._changed()

    def find(self, name: str, group: str | None = None) -> tuple[str, Positions] | None:
        """Return the spelling of a name and its state, also of a group in the SRDF; None without such a state."""
        states = self._of(group)
        spelled = _spelling(name, states)
        return None if spelled is None else (spelled, states[spelled])

    def nearest_name(self, name: str, group: str) -> str | None:
        """Return the existing name most similar to a missing one, or None; as :meth:`find`."""
        by_key = {_key(known): known for known in self._of(group)}
        alike = difflib.get_close_matches(_key(name), by_key, 1, MIN_SIMILARITY)
        return by_key[alike[0]] if alike else None

    def _of(self, group: str | None) -> dict[str, Positions]:
        described = self.described if group is None else self._states_of_groups.get(group, {})
        return {**self.saved, **described}

    def on_change(self, listener: Callable[[], None]) -> None:
        self._listeners.append(listener)

    async def save(self, name: str, positions_rad: Positions) -> None:
        spelled = " ".join(name.split())
        self._check(spelled, positions_rad)

        def add(states: States) -> States:
            others = {known: state for known, state in states.items() if _key(known) != _key(spelled)}
            if len(others) >= MAX_STATES:
                raise ServiceError(f"name: {len(others)} states are saved already, the limit is {MAX_STATES}")
            return {**others, spelled: dict(positions_rad)}

        await self._change(add)

    async def delete(self, name: str) -> None:
        def remove(states: States) -> States:
            spelled = _spelling(name, (*self.described, *states))
            if spelled is None:
                known = ", ".join(sorted((*self.described, *states)))
                raise ServiceError(f"name: there is no state {name!r}; known are: {known}")
            if spelled in self.described:
                raise ServiceError(f"name: {spelled!r} is a state of the SRDF, which is not changed here")
            return {known: state for known, state in states.items() if known != spelled}

        await self._change(remove)

    async def _change(self, change: Change) -> None:
        states = await self._disk.serve(self._path, "the state cannot be kept", lambda: self._write(change))
        self.saved = self._usable(states)
        self._changed()

    def _changed(self) -> None:
        for listener in self._listeners:
            listener()

    def _usable(self, states: Mapping[str, Positions]) -> dict[str, Positions]:
        usable: dict[str, Positions] = {}
        for name, positions_rad in states.items():
            with contextlib.suppress(ServiceError):
                self._check(name, positions_rad)
                usable[name] = dict(positions_rad)
        return usable

    def _check(self, name: str, positions_rad: Positions) -> None:
        if not 1 <= len(name) <= MAX_NAME_LENGTH or not name.isprintable():
            raise ServiceError(
                f"name: must have 1 to {MAX_NAME_LENGTH} printable characters, not {name[:MAX_NAME_LENGTH]!r}"
            )
        if any(_key(described) == _key(name) for described in self.described):
            raise ServiceError(f"name: {name!r} is a state of the SRDF, which is not changed here")
        if not positions_rad:
            raise ServiceError("state: names no joint of the robot")
        for joint_name, position_rad in positions_rad.items():
            joint = self._joints.get(joint_name)
            if joint is None:
                raise ServiceError(f"state: the robot has no joint {joint_name!r}; it has {', '.join(self._joints)}")
            if not math.isfinite(position_rad):
                raise ServiceError(
                    f"state: the position of joint {joint_name} must be a finite number, not {position_rad}"
                )

    def _load(self) -> States:
        """Read the states; rename an invalid file, and log it."""
        try:
            with contextlib.suppress(ValueError):
                return self._read()
            # Read once more under the lock: another server may have put a good file in its place.
            with files.locked(self._path):
                return self._read_or_set_aside()
        except OSError as error:
            log.warning("saved states in %s cannot be read, nor set aside: %s", self._path, error)
            return {}

    def _write(self, change: Change) -> States:
        """Change the states in the file, also states of other servers; a crash leaves the old file or the new one."""
        with files.locked(self._path):
            states = change(self._read_or_set_aside())
            files.replace(self._path, json.dumps({"states": states}, indent=1).encode())
            return states

    def _read(self) -> States:
        try:
            return _Content.model_validate(read_json(self._path, MAX_FILE_BYTES)).states
        except FileNotFoundError:
            return {}

    def _read_or_set_aside(self) -> States:
        """Read the states; rename an invalid file, whose lock is held."""
        try:
            return self._read()
        except ValueError as error:
            reason: object = error
            if isinstance(error, ValidationError):
                first = error.errors()[0]
                reason = ": ".join((*(str(part) for part in first["loc"]), first["msg"]))
            aside = set_aside(self._path)
            log.warning("saved states in %s cannot be used: %s; the file is now %s", self._path, reason, aside)
            return {}


def _key(name: str) -> str:
    return "".join(name.split()).casefold()


def _spelling(name: str, known: Iterable[str]) -> str | None:
    return next((spelled for spelled in known if _key(spelled) == _key(name)), None)


class _Content(BaseModel):
    model_config = ConfigDict(strict=True)

    states: States


def default_path(content: str, robot: RobotModel, environment: Mapping[str, str]) -> Path:
    """Return the default path of a file that the server keeps of a robot."""
    safe = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in robot.name)
    return data_directory(environment) / f"{content}_{safe}.json"


def data_directory(environment: Mapping[str, str]) -> Path:
    """Return the directory of the server's files, in the XDG base directory for data."""
    home = Path(environment.get("HOME", "~")).expanduser()
    return Path(environment.get("XDG_DATA_HOME") or home / ".local/share") / "armbridge"


class NamedStatesServices:
    """Services that list, save and delete states, and the latched topic ``/named_states``."""

    def __init__(self, graph: Graph, robot: RobotModel, states: NamedStates, current: CurrentState) -> None:
        self._robot = robot
        self._states = states
        self._current = current
        self._node = graph.node("named states")
        self._node.advertise(NAMED_STATES_TOPIC, "std_msgs/String", latch=True)
        self._publish()
        self._states.on_change(self._publish)
        self._offer("/list_robot_states", "ListRobotStatesInWarehouse", self._list, LOOKING)
        self._offer("/save_robot_state", "SaveRobotStateToWarehouse", self._save, CONFIGURING)
        self._offer("/delete_robot_state", "DeleteRobotStateFromWarehouse", self._delete, CONFIGURING)

    def _offer(self, name: str, type_name: str, function: ServiceFunction, rule: Rule) -> None:
        def serve(request: dict[str, Any]) -> Answered | Awaitable[Answered]:
            if request["robot"] not in ("", self._robot.name):
                raise ServiceError(f"robot: there is no robot {request['robot']!r}; this is {self._robot.name!r}")
            return function(request)

        self._node.offer(name, f"moveit_msgs/{type_name}", serve, rule=rule)

    def _publish(self) -> None:
        states = {
            **{name: {"saved": False, "joints": state} for name, state in self._states.described.items()},
            **{name: {"saved": True, "joints": state} for name, state in self._states.saved.items()},
        }
        self._node.publish(NAMED_STATES_TOPIC, {"data": json.dumps(states)})

    def _list(self, request: Message) -> Message:
        if request["regex"]:
            raise ServiceError(f"regex: must be empty, for all names, not {shorten(request['regex'])!r}")
        return {"states": self._states.names()}

    async def _save(self, request: Message) -> Message:
        """Save the state in the request; without joints, the present positions of the arm."""
        given = request["state"]["joint_state"]
        names, positions = given["name"], given["position"]
        if len(names) != len(positions):
            raise ServiceError(f"state.joint_state: {len(names)} names and {len(positions)} positions")
        positions_rad: Positions | None = dict(zip(names, positions, strict=True)) or self._current.positions_rad()
        if positions_rad is None:
            raise ServiceError("state: has no joints, and joint positions unknown: the arm is not connected")
        await self._states.save(request["name"], positions_rad)
        return {"success": True}

    async def _delete(self, request: Message) -> Message:
        await self._states.delete(request["name"])
        return {}
