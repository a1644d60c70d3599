"""Backup of the servos' registers: a JSON file, written before the first change of a servo.

The file grows servo by servo and is replaced as a whole each time; a file that is there already is never touched.
Registers are named, so that people can read it. A servo has no serial number: it is recognised by its id.
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
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import (
    CONTROL_ADDRESS,
    CONTROL_BYTES,
    LAYOUT,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    decode,
    value_range,
)
from robot.hardware.feetech.settings import SETTINGS_ADDRESS, SETTINGS_BYTES
from robot.hardware.interface import Steps
from robot.hardware.servos.bus import read_block

FORMAT: Literal["armbridge servo registers 1"] = "armbridge servo registers 1"

# All documented registers, in blocks that the bus reads elsewhere too: a servo need not answer any longer read.
BLOCKS = (
    (SETTINGS_ADDRESS, SETTINGS_BYTES),
    (CONTROL_ADDRESS, CONTROL_BYTES),
    (TELEMETRY_ADDRESS, TELEMETRY_BYTES),
)

# Forty servos with all their registers; an arm has six.
MAX_FILE_BYTES = 100_000


@dataclass(frozen=True)
class SavedServo:
    """Registers of one servo before it was changed.

    Attributes:
        joint: joint of the arm that it was to turn.
        servo_id: id that it had.
        new_id: id that it was to get.
        baudrate: baud rate at which it answered.
        registers: value of every register.
    """

    joint: str
    servo_id: int
    new_id: int
    baudrate: int
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
    """File to which the servos of one visit are saved; it is created with the first.

    Args:
        path: of the file, which must not exist.
        robot: name of the arm.

    Attributes:
        path: as given.

    Raises:
        BackupError: it exists.
    """

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
        """Save a servo; on return the file holds it, also after a loss of power.

        Args:
            servo: registers before they are changed.
            now: wall-clock time.

        Raises:
            BackupError: the file cannot be written, or appeared meanwhile.
        """
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
    """Read a backup.

    Raises:
        BackupError: it cannot be read, or is not one.
    """
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
    """Return the backup of each servo on the bus, by its present id; without those that cannot be told.

    A servo usually has the id that it was to get. One whose setup was broken off has the id from before, which every
    new servo has: it counts only if the servo with the new id is missing, and no other servo may be meant.

    Args:
        saved: servos of a backup.
        ids: present ids of the servos.
    """
    found = {}
    for servo_id in ids:
        # The first backup of a servo holds what it had before all changes.
        got = [servo for servo in saved if servo.new_id == servo_id][:1]
        kept = [servo for servo in saved if servo.servo_id == servo_id and servo.new_id not in ids]
        if len(got or kept) == 1:
            found[servo_id] = (got or kept)[0]
    return found


def read_registers(bus: Bus, servo_id: int) -> Steps[dict[Register, int]]:
    """Read every register of a servo, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    values: dict[Register, int] = {}
    for address, length in BLOCKS:
        frame = yield from read_block(bus, servo_id, address, length)
        values |= _decoded(frame.data, address)
    return values


def _decoded(data: bytes, address: int) -> dict[Register, int]:
    """Decode the registers of a block that begins at an address."""
    inside = (register for register in LAYOUT if address <= register < address + len(data))
    return {
        register: decode(register, data[register - address : register - address + LAYOUT[register].size])
        for register in inside
    }


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
