"""The file ``robot.toml`` of an arm's folder: its typed model, and everything that is wrong with one at once."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from robot.description.camera import CAMERA_NAME, MAX_CAMERAS, Camera
from robot.description.servo_table import MAX_SERVO_ID, HardwareKind
from robot.errors import RobotFileError

FILE_NAME = "robot.toml"

# More than any description names; bounds the work that a file can cause.
MAX_JOINTS = 100
MAX_BYTES = 1_000_000

LIKENESS = 0.6  # below this share of equal letters a proposal misleads

Position: TypeAlias = Annotated[float, Field(ge=-1000.0, le=1000.0)]
MAX_RATE = 1e6
Rate: TypeAlias = Annotated[float, Field(gt=0.0, le=MAX_RATE)]
Name: TypeAlias = Annotated[str, Field(min_length=1, max_length=200)]
CameraName: TypeAlias = Annotated[str, Field(pattern=CAMERA_NAME)]  # first part of names of topics


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RobotTable(_Table):
    """Table ``[robot]``: the files of the description, relative to the folder."""

    title: Name | None = None  # name of the arm for people; the folder's without one
    urdf: Path | None = None  # the URDF; the only one in the folder without this key
    srdf: Path | None = None  # the SRDF; the only one in the folder without this key
    hulls: Path | None = None  # convex hull of each link, JSON
    parts: Path | None = None  # convex parts of each link, JSON
    surfaces: Path | None = None  # triangles of each link's surface, numpy's npz
    # Folders of packages that ``package://`` names.
    packages: Annotated[tuple[Path, ...], Field(max_length=MAX_JOINTS)] = ()
    joint_limits: Path | None = None  # MoveIt's joint_limits.yaml


class PlanningTable(_Table):
    """Table ``[planning]``."""

    group: Name | None = None  # group of goals that name none; "arm", else the first with a chain, without this key
    tip: Name | None = None  # link that pose goals of this group move; the tip of its chain without this key
    frame: Name | None = None  # frame of poses that name none; it must be the root link
    # Named state of the SRDF in which the arm is parked; "rest", if there is one, without this key.
    park: Name | None = None


class GripperTable(_Table):
    """Table ``[gripper]``."""

    # Its joints, one or two that mirror each other.
    joints: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2)]
    open: Position  # position of each joint when it is open [rad, or m of a prismatic joint]
    closed: Position  # position of each joint when it is closed [rad or m]


class JointTable(_Table):
    """Table ``[joints.NAME]``: limits that replace the URDF's."""

    max_velocity: Rate | None = None  # [rad/s or m/s]
    max_acceleration: Rate | None = None  # [rad/s^2 or m/s^2]
    max_jerk: Rate | None = None  # [rad/s^3 or m/s^3]


class ZeroTable(_Table):
    """Value of the key ``zero``: the joint is at ``angle_rad`` at ``tick``."""

    # [ticks], or the middle of the calibrated range.
    tick: Annotated[int, Field(ge=-1_048_575, le=1_048_575)] | Literal["middle"]
    angle_rad: Annotated[float, Field(ge=-10.0, le=10.0)]  # [rad]


class ServoTable(_Table):
    """Table ``[[hardware.servos]]``."""

    joint: Name  # the joint that it turns
    id: Annotated[int, Field(ge=0, le=MAX_SERVO_ID)]  # its id on the bus
    model: Name  # its model, as "sts3215"
    sign: Literal[1, -1] = 1  # -1 for ticks that fall while the joint's position rises
    zero: Literal["middle", "ends"] | ZeroTable = "middle"  # place of the joint's zero
    turns_freely: bool = False  # true for a joint without end stops


class ProfileTable(_Table):
    """Table ``[hardware.profile]``: settings that the servos should have, by the names of their registers."""

    base: Literal["factory", "lerobot"] = "factory"  # profile from which they differ
    registers: Annotated[dict[Name, int], Field(max_length=MAX_JOINTS)] = {}  # values for every servo, as P_GAIN = 20
    gripper: Annotated[dict[Name, int], Field(max_length=MAX_JOINTS)] = {}  # values for the gripper's servos


class HardwareSection(_Table):
    """Table ``[hardware]``."""

    kind: HardwareKind = "ideal"  # kind of the servos
    baud: Annotated[int, Field(ge=9600, le=4_500_000)] = 1_000_000  # rate of the bus [baud]
    # Lerobot's folders of calibrations of the arm, the newest name first.
    calibrations: Annotated[tuple[Name, ...], Field(max_length=8)] = ()
    # The servos, in the order of the joints.
    servos: Annotated[tuple[ServoTable, ...], Field(max_length=MAX_JOINTS)] = ()
    # Settings of the servos; without this table the factory's or lerobot's, whichever are nearer.
    profile: ProfileTable | None = None

    @model_validator(mode="after")
    def _servos_fit_the_kind(self) -> HardwareSection:
        if self.kind == "ideal" and self.servos:
            raise ValueError('the kind "ideal" has no servos: name the kind of the bus, or leave the servos out')
        if self.kind != "ideal" and not self.servos:
            raise ValueError(f'the kind "{self.kind}" needs its table [[hardware.servos]], a row a joint')
        for key in ("id", "joint"):
            owners: dict[Any, int] = {}
            for row, servo in enumerate(self.servos):
                value = getattr(servo, key)
                if (first := owners.setdefault(value, row)) != row:
                    raise ValueError(
                        f"servos[{row}].{key} {value!r} stands at servos[{first}] as well: give it another one"
                    )
        return self


class RobotFile(_Table):
    """The whole file."""

    robot: RobotTable = RobotTable()
    planning: PlanningTable = PlanningTable()
    gripper: GripperTable | None = None
    joints: Annotated[dict[Name, JointTable], Field(max_length=MAX_JOINTS)] = {}
    held_joints: Annotated[dict[Name, Position], Field(max_length=MAX_JOINTS)] = {}
    cameras: Annotated[dict[CameraName, Camera], Field(max_length=MAX_CAMERAS)] = {}
    hardware: HardwareSection = HardwareSection()


def read(path: Path) -> RobotFile:
    """Read a file; the error names all keys and values that are not allowed."""
    try:
        with path.open("rb") as stream:
            text = stream.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise RobotFileError(path, [f"has more than {MAX_BYTES} bytes"])
        values = tomllib.loads(text.decode())
    except (OSError, UnicodeDecodeError) as error:
        raise RobotFileError(path, [f"cannot be read: {error}"]) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RobotFileError(path, [f"is no TOML: {error}"]) from error
    try:
        return RobotFile.model_validate(values)
    except ValidationError as error:
        raise RobotFileError(path, [_sentence(each) for each in error.errors(include_url=False)]) from error


def _sentence(error: ErrorDetails) -> str:
    place = [part for part in error["loc"] if not str(part).startswith(("literal[", "ZeroTable", "constrained"))]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    if error["type"] == "extra_forbidden":
        names = [part for part in place[:-1] if isinstance(part, str)] or [""]
        known = sorted((_NAMED_TABLES.get(names[0]) or _TABLES[names[-1]]).model_fields)
        nearest = difflib.get_close_matches(str(place[-1]), known, n=1, cutoff=LIKENESS)
        return f"{key}: there is no such key" + (
            f"; did you mean {nearest[0]}?" if nearest else f", but {', '.join(known)}"
        )
    if error["type"] == "missing":
        return f"{key}: is missing"
    message = error["msg"].removeprefix("Value error, ")
    given = "" if error["type"] == "value_error" else f", not {error['input']!r}"
    return f"{key}: {message[:1].lower()}{message[1:]}{given}"


# Tables whose places end with a name of its own, such as a joint's.
_NAMED_TABLES: Mapping[str, type[BaseModel]] = {"joints": JointTable, "cameras": Camera}

# Other tables by the last name of their place.
_TABLES: Mapping[str, type[_Table]] = {
    "": RobotFile,
    "robot": RobotTable,
    "planning": PlanningTable,
    "gripper": GripperTable,
    "hardware": HardwareSection,
    "servos": ServoTable,
    "zero": ZeroTable,
    "profile": ProfileTable,
}
