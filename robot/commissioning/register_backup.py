"""Backup of the servos' registers: a JSON file, written before the first change of a servo.

The file grows servo by servo and is replaced as a whole each time; a file that is there already is never touched.
Registers are named, so that people can read it. A servo has no serial number: it is recognised by its id. A file that
cannot be read or written raises BackupError.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError

from robot import files
from robot.description.servo_table import MAX_SERVO_ID
from robot.errors import BackupError
from robot.hardware.feetech.registers import Register, value_range

MAX_FILE_BYTES = 100_000  # forty servos with all their registers; an arm has six


def _by_register(held: Mapping[str | Register, int]) -> dict[Register, int]:
    """Convert names of registers; raises ValueError for an unknown one, and for a value that it cannot hold."""
    found = {}
    for name, value in held.items():
        if name not in Register.__members__ and name not in list(Register):
            raise ValueError(f"there is no register {name}")
        register = name if isinstance(name, Register) else Register[name]
        lowest, highest = value_range(register)
        if not lowest <= value <= highest:
            raise ValueError(f"{name} must be {lowest} to {highest}, not {value}")
        found[register] = value
    return found


ServoId: TypeAlias = Annotated[int, Field(ge=0, le=MAX_SERVO_ID)]
Registers: TypeAlias = Annotated[
    dict[Register, int],
    BeforeValidator(_by_register),
    PlainSerializer(lambda held: {register.name: value for register, value in held.items()}),
]


class SavedServo(BaseModel):
    """Registers of one servo before it was changed."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, populate_by_name=True)

    joint: Annotated[str, Field(max_length=200)]  # joint of the arm that it was to turn
    servo_id: ServoId = Field(alias="id")  # id that it had
    new_id: ServoId  # id that it was to get
    baudrate: Annotated[int, Field(gt=0)]  # baud rate at which it answered
    registers: Registers


class _Content(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")

    format: Literal["armbridge servo registers 1"] = "armbridge servo registers 1"
    robot: str
    saved_at: str
    servos: tuple[SavedServo, ...]


class BackupFile:
    """File to which the servos of one visit are saved; it is created with the first, and never overwritten."""

    def __init__(self, path: Path, robot: str) -> None:
        if path.exists():
            raise BackupError(path, "is there already, and a backup is never overwritten: choose another name")
        self.path = path
        self._robot = robot
        self._servos: tuple[SavedServo, ...] = ()

    @property
    def empty(self) -> bool:
        """True until a servo is saved."""
        return not self._servos

    def save(self, servo: SavedServo, now: datetime) -> None:
        """Save a servo; on return the file holds it, also after a loss of power."""
        saved_at = now.astimezone(UTC).isoformat(timespec="seconds")
        content = _Content(robot=self._robot, saved_at=saved_at, servos=(*self._servos, servo))
        try:
            if self.empty:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self.path.open("xb").close()
            files.replace(self.path, content.model_dump_json(indent=2, by_alias=True).encode() + b"\n")
        except OSError as error:
            raise BackupError(self.path, f"cannot be written: {error}") from error
        self._servos = content.servos


def read_backup(path: Path) -> tuple[SavedServo, ...]:
    """Read a backup."""
    try:
        with path.open("rb") as file:
            return _Content.model_validate_json(file.read(MAX_FILE_BYTES)).servos
    except OSError as error:
        raise BackupError(path, f"cannot be read: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "content"
        raise BackupError(path, f"is no backup of servo registers: {place}: {first['msg']}") from error


def match_saved(saved: Sequence[SavedServo], ids: Collection[int]) -> dict[int, SavedServo]:
    """Return the backup of each servo on the bus, by its present id; without servos whose backup is uncertain.

    A servo usually has the id that it was to get. One whose setup was broken off has the id from before, which every
    new servo has: it counts only if the servo with the new id is missing, and no other servo may be meant.
    """
    found = {}
    for servo_id in ids:
        # The first backup of a servo holds what it had before all changes.
        got = [servo for servo in saved if servo.new_id == servo_id][:1]
        kept = [servo for servo in saved if servo.servo_id == servo_id and servo.new_id not in ids]
        if len(got or kept) == 1:
            found[servo_id] = (got or kept)[0]
    return found
