"""Backup of the servos' registers: a JSON file, written before the first change of a servo.

The file grows servo by servo and is replaced as a whole each time; a file that is there already is never touched.
Registers are named, so that people can read it. A servo has no serial number: it is recognised by its id. A file that
cannot be read or written raises BackupError.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robot import files
from robot.description.servo_table import MAX_SERVO_ID
from robot.errors import BackupError
from robot.hardware.feetech.registers import Register, value_range

FORMAT: Literal["armbridge servo registers 1"] = "armbridge servo registers 1"

MAX_FILE_BYTES = 100_000  # forty servos with all their registers; an arm has six


@dataclass(frozen=True)
class SavedServo:
    """Registers of one servo before it was changed."""

    joint: str  # joint of the arm that it was to turn
    servo_id: int  # id that it had
    new_id: int  # id that it was to get
    baudrate: int  # baud rate at which it answered
    registers: Mapping[Register, int]


class _Servo(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")

    joint: Annotated[str, Field(max_length=200)]
    id: Annotated[int, Field(ge=0, le=MAX_SERVO_ID)]
    new_id: Annotated[int, Field(ge=0, le=MAX_SERVO_ID)]
    baudrate: Annotated[int, Field(gt=0)]
    registers: dict[str, int]


class _Content(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")

    format: Literal["armbridge servo registers 1"]
    robot: str
    saved_at: str
    servos: list[_Servo]


class BackupFile:
    """File to which the servos of one visit are saved; it is created with the first, and never overwritten."""

    def __init__(self, path: Path, robot: str) -> None:
        if path.exists():
            raise BackupError(path, "is there already, and a backup is never overwritten: choose another name")
        self.path = path
        self._robot = robot
        self._servos: list[SavedServo] = []

    @property
    def empty(self) -> bool:
        """True until a servo is saved."""
        return not self._servos

    def save(self, servo: SavedServo, now: datetime) -> None:
        """Save a servo; on return the file holds it, also after a loss of power."""
        servos = [*self._servos, servo]
        content = _Content(
            format=FORMAT,
            robot=self._robot,
            saved_at=now.astimezone(UTC).isoformat(timespec="seconds"),
            servos=[_as_entry(each) for each in servos],
        )
        try:
            if self.empty:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self.path.open("xb").close()
            files.replace(self.path, content.model_dump_json(indent=2).encode() + b"\n")
        except OSError as error:
            raise BackupError(self.path, f"cannot be written: {error}") from error
        self._servos = servos


def read_backup(path: Path) -> tuple[SavedServo, ...]:
    """Read a backup."""
    try:
        with path.open("rb") as file:
            content = _Content.model_validate_json(file.read(MAX_FILE_BYTES))
    except OSError as error:
        raise BackupError(path, f"cannot be read: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "content"
        raise BackupError(path, f"is no backup of servo registers: {place}: {first['msg']}") from error
    return tuple(_from_entry(path, entry) for entry in content.servos)


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


def _as_entry(servo: SavedServo) -> _Servo:
    return _Servo(
        joint=servo.joint,
        id=servo.servo_id,
        new_id=servo.new_id,
        baudrate=servo.baudrate,
        registers={register.name: value for register, value in servo.registers.items()},
    )


def _from_entry(path: Path, entry: _Servo) -> SavedServo:
    return SavedServo(
        joint=entry.joint,
        servo_id=entry.id,
        new_id=entry.new_id,
        baudrate=entry.baudrate,
        registers=dict(_registers(path, entry)),
    )


def _registers(path: Path, entry: _Servo) -> Iterable[tuple[Register, int]]:
    for name, value in entry.registers.items():
        if name not in Register.__members__:
            raise BackupError(path, f"servo {entry.id}: there is no register {name}")
        lowest, highest = value_range(Register[name])
        if not lowest <= value <= highest:
            raise BackupError(path, f"servo {entry.id}: {name} must be {lowest} to {highest}, not {value}")
        yield Register[name], value
