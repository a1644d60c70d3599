"""Setup of new servos: each gets its id and the settings that the driver relies on; only what differs is written.

New servos all have the id 1, so that only one of them may be on the bus. The state of a setup is what the servos hold:
a servo is looked for at every baud rate and id, and one whose setup was broken off is found again and finished. Its id
is written after its other settings, and its baud rate last.

The backup of the registers is a JSON file, written before the first change of a servo; it grows servo by servo and is
replaced as a whole each time, and a file that is there already is never touched. A servo has no serial number: it is
recognised by its id.
"""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError

from robot import files
from robot.commissioning.scan import BAUDRATE_BY_CODE, BAUDRATES, FACTORY_ID, ServoRegisters, read_all
from robot.description.servo_table import MAX_SERVO_ID, ServoSpec
from robot.errors import BackupError, NoReply, RobotError, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import NO_LIMITS, PHASE_MULTI_TURN, POSITION_MODE
from robot.hardware.feetech.profiles import ServoProfile
from robot.hardware.feetech.registers import EPROM, TELEMETRY, Register
from robot.hardware.interface import Result, Steps, run_to_end
from robot.hardware.servos.bus import ATTEMPTS, STEP_ATTEMPTS, read, write_verified

MAX_FILE_BYTES = 100_000  # forty servos with all their registers; an arm has six


def _by_register(held: Mapping[str | Register, int]) -> dict[Register, int]:
    found = {}
    for name, value in held.items():
        if name not in Register.__members__ and name not in list(Register):
            raise ValueError(f"there is no register {name}")
        register = name if isinstance(name, Register) else Register[name]
        lowest, highest = register.value_range
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


# Baud rate of the driver, 1 Mbaud, and its value of register BAUD_RATE.
BAUDRATE = BAUDRATES[0]
BAUDRATE_CODE = 0

# Time for the last bytes to leave the adapter, and for the servo to store its new rate, before the port is reopened.
REOPENING_S = 0.05

ACKNOWLEDGES_ALL = 1  # Register RESPONSE_LEVEL of a servo that acknowledges every instruction

FULL_RANGE_TICKS = (0, 4095)

# Reads that tell one servo from several of one id, whose replies collide, and how many of them may be disturbed: a bad
# plug disturbs some, two servos nearly all.
PROBES = 6
MAX_DISTURBED = 2

PROBE_INTERVAL_S = 0.01  # longest return delay, 0.5 ms, and the time of a reply through a slow adapter

NO_ANSWER = (
    "no servo answers at any baud rate: is the supply on, the adapter's jumper on B, and the servo's plug pushed home?"
)


class ServoLine:
    """Port of the servos, open at one baud rate at a time."""

    def __init__(self, open_bus: Callable[[int], Bus], wait: Callable[[float], None] = time.sleep) -> None:
        self._open = open_bus
        self._wait = wait
        self._bus: Bus | None = None
        self._baudrate = 0

    def at(self, baudrate: int) -> Bus:
        if self._bus is None or self._baudrate != baudrate:
            self.close()
            self._bus, self._baudrate = self._open(baudrate), baudrate
        return self._bus

    def run(self, steps: Steps[Result]) -> Result:
        return run_to_end(steps, self._wait)

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()


@dataclass(frozen=True)
class Change:
    """Register that is to get another value."""

    register: Register
    held: int
    wanted: int


def search(
    line: ServoLine, joint: ServoSpec, arm: Sequence[ServoSpec], say: Callable[[str], None], *, only_joint: bool = False
) -> ServoRegisters:
    """Find the servo that is to turn a joint, at any baud rate and with any id.

    Raises StartupError where no servo may be meant, or more than one; the text says how to part them. For the only
    joint that the user names, a servo alone on the bus counts as new although it has another joint's id.
    """
    found: list[ServoRegisters] = []
    for baudrate in BAUDRATES:
        if baudrate != BAUDRATE:
            say(f"looking at {baudrate} baud ...")
        found += look(line, baudrate, {joint.servo_id, FACTORY_ID})
        if candidates := _candidates(found, joint, arm, only_joint=only_joint):
            if len(candidates) > 1:
                ids = ", ".join(str(servo.servo_id) for servo in candidates)
                raise StartupError(
                    f"servos {ids} answer, and any of them may be the servo of {joint.joint}: unplug all but this one"
                )
            return candidates[0]
    if not found:
        raise StartupError(NO_ANSWER)
    names = {servo.servo_id: servo.joint for servo in arm}
    present = ", ".join(f"{servo.servo_id} ({names.get(servo.servo_id, 'of another arm')})" for servo in found)
    raise StartupError(
        f"only servo {present} answers, which has its id or a calibration already: plug in the servo of {joint.joint}, "
        f"or push its plug home. If it is the servo of {joint.joint} with another joint's id, connect it alone and "
        f"call armbridge setup --joint {joint.joint}. To use a servo that was calibrated elsewhere, reset it with "
        "Feetech's FD program first"
    )


def look(line: ServoLine, baudrate: int, ids: Collection[int]) -> list[ServoRegisters]:
    """Find and read the servos at one baud rate; ids are also asked alone. Raises StartupError for two of one id."""
    bus = line.at(baudrate)
    garbled = bus.counters.discarded_bytes
    heard = set(bus.broadcast_ping())
    garbled = bus.counters.discarded_bytes - garbled
    heard |= {servo_id for servo_id in ids if servo_id not in heard and _answers(bus, servo_id)}
    for servo_id in sorted(heard):
        line.run(_check_single(bus, servo_id))
    if garbled and not heard:
        raise StartupError(
            f"replies at {baudrate} baud are garbled: several servos with the same id answer at once, or a plug has "
            "bad contact; unplug all servos but one"
        )
    return [ServoRegisters(each, line.run(read_all(bus, each)), baudrate) for each in sorted(heard)]


def supply_complaint(servo: ServoRegisters) -> str:
    """Return a sentence about a supply that the servo is not made for, empty for a good one."""
    lowest, highest = servo.voltage_limits_v
    if lowest <= servo.voltage_v <= highest:
        return ""
    consequence = (
        "it may burn out: switch the supply off" if servo.voltage_v > highest else "it is too weak: use another supply"
    )
    return (
        f"servo {servo.servo_id} has a supply of {servo.voltage_v:.1f} V and is made for {lowest:.1f} to "
        f"{highest:.1f} V: {consequence}"
    )


def changes_for(servo: ServoRegisters, joint: ServoSpec, profile: ServoProfile) -> tuple[Change, ...]:
    """Return the registers to change for a servo to turn a joint.

    Angle limits and homing offset of a servo that has the joint's id are its calibration, and stay. Limits and offset
    of any other belong to another joint and are cleared.
    """
    held = servo.registers
    wanted = {
        Register.RETURN_DELAY: 0,
        Register.RESPONSE_LEVEL: ACKNOWLEDGES_ALL,
        Register.PHASE: held[Register.PHASE] & ~PHASE_MULTI_TURN,
        Register.OPERATING_MODE: POSITION_MODE,
        **profile.expected(gripper=joint.gripper),
        Register.ID: joint.servo_id,
        Register.BAUD_RATE: BAUDRATE_CODE,
    }
    lowest, highest = FULL_RANGE_TICKS
    if servo.servo_id != joint.servo_id or servo.angle_limits_ticks == NO_LIMITS:
        wanted |= {Register.MIN_ANGLE_LIMIT: lowest, Register.MAX_ANGLE_LIMIT: highest}
    # After the limits: an interrupted write must not leave a new offset with old limits.
    if servo.servo_id != joint.servo_id:
        wanted[Register.HOMING_OFFSET] = 0
    return _changes(held, wanted)


def changes_back(servo: ServoRegisters, saved: SavedServo, *, alone: bool) -> tuple[Change, ...]:
    """Return the registers to change for a servo to be as saved; id and baud rate only of a servo alone on the bus."""
    back = {register: saved.registers[register] for register in EPROM if register in saved.registers}
    if not alone:
        back.pop(Register.ID, None)
    # A rate that the file does not vouch for might make the servo unreachable.
    if not alone or BAUDRATE_BY_CODE.get(back.get(Register.BAUD_RATE, -1)) != saved.baudrate:
        back.pop(Register.BAUD_RATE, None)
    return _changes(servo.registers, back)


def needs_writing(servo: ServoRegisters, changes: Sequence[Change]) -> bool:
    """Return True for a servo with registers to change, or whose EPROM is unlocked."""
    return bool(changes) or servo[Register.LOCK] != 1


def write(line: ServoLine, servo: ServoRegisters, changes: Sequence[Change]) -> ServoRegisters:
    """Relax a servo, write its changes and verify them, and lock its EPROM; return it as read afterwards."""
    writer = _Writer(line, servo.servo_id, servo.baudrate)
    try:
        writer.unlock()
        for change in changes:
            writer.write(change)
        writer.lock()
    except BaseException:
        # An interrupted exchange may leave replies behind: the port is opened again.
        line.close()
        with contextlib.suppress(RobotError):
            writer.lock()
        raise
    registers = line.run(read_all(line.at(writer.baudrate), writer.servo_id))
    if kept := [change for change in changes if registers[change.register] != change.wanted]:
        names = ", ".join(f"{change.register.name} {registers[change.register]}" for change in kept)
        raise StartupError(f"servo {writer.servo_id} does not keep what was written to it: it has {names}")
    return ServoRegisters(writer.servo_id, registers, writer.baudrate)


class _Writer:
    """Access to one servo whose id and baud rate change on the way."""

    def __init__(self, line: ServoLine, servo_id: int, baudrate: int) -> None:
        self._line = line
        self.servo_id = servo_id
        self.baudrate = baudrate

    def unlock(self) -> None:
        bus = self._line.at(self.baudrate)
        try:
            self._line.run(write_verified(bus, self.servo_id, Register.TORQUE_ENABLE, 0))
        except StartupError as error:
            raise StartupError(
                f"servo {self.servo_id} does not switch its torque off: cut the servos' supply and switch it on again"
            ) from error
        self._line.run(write_verified(bus, self.servo_id, Register.LOCK, 0))

    def write(self, change: Change) -> None:
        match change.register:
            case Register.ID:
                self._line.run(self._write_id(change.wanted))
            case Register.BAUD_RATE:
                self._line.run(self._write_baudrate(change.wanted))
            case _:
                bus = self._line.at(self.baudrate)
                self._line.run(write_verified(bus, self.servo_id, change.register, change.wanted))

    def lock(self) -> None:
        self._line.run(write_verified(self._line.at(self.baudrate), self.servo_id, Register.LOCK, 1))

    def _write_id(self, new_id: int) -> Steps[None]:
        bus = self._line.at(self.baudrate)
        for _ in range(STEP_ATTEMPTS):
            yield 0.0
            # The servo may acknowledge with either id.
            with contextlib.suppress(NoReply):
                bus.write(self.servo_id, Register.ID, new_id)
            with contextlib.suppress(NoReply):
                if (yield from read(bus, new_id, Register.ID)) == new_id:
                    self.servo_id = new_id
                    return
        raise StartupError(f"servo {self.servo_id} does not take the id {new_id}")

    def _write_baudrate(self, code: int) -> Steps[None]:
        before, after = self.baudrate, BAUDRATE_BY_CODE[code]
        for _ in range(ATTEMPTS):
            # A sync write is not acknowledged: a servo may reply at either rate.
            self._line.at(before).sync_write(Register.BAUD_RATE, {self.servo_id: bytes([code])})
            yield REOPENING_S
            with contextlib.suppress(NoReply):
                if (yield from read(self._line.at(after), self.servo_id, Register.BAUD_RATE)) == code:
                    self.baudrate = after
                    return
        raise StartupError(f"servo {self.servo_id} does not answer at {after} baud after it was set to it")


def _candidates(
    found: Sequence[ServoRegisters], joint: ServoSpec, arm: Sequence[ServoSpec], *, only_joint: bool
) -> list[ServoRegisters]:
    """Return the candidates for a joint: the servo with its id, else those without a calibration or another's id."""
    own = [servo for servo in found if servo.servo_id == joint.servo_id]
    others = {servo.servo_id for servo in arm} - {FACTORY_ID}
    if only_joint and len(found) == 1:
        others = set()
    # Angle limits are of a calibration always; a new servo may have an offset.
    uncalibrated = [servo for servo in found if servo.angle_limits_ticks in (NO_LIMITS, FULL_RANGE_TICKS)]
    return own or [servo for servo in uncalibrated if servo.servo_id not in others]


def _answers(bus: Bus, servo_id: int) -> bool:
    for _ in range(ATTEMPTS):
        before = bus.counters.discarded_bytes
        if bus.sync_read((servo_id,), TELEMETRY.address, TELEMETRY.length) or bus.counters.discarded_bytes > before:
            return True
    return False


def _check_single(bus: Bus, servo_id: int) -> Steps[None]:
    """Raise StartupError when several servos answer to an id: their replies collide, or come one after the other."""
    disturbed = 0
    for _ in range(PROBES):
        before = bus.counters.discarded_bytes
        # The reply of a servo with a longer return delay comes by itself, behind the first one.
        yield PROBE_INTERVAL_S
        with contextlib.suppress(NoReply):
            bus.read(servo_id, Register.PRESENT_POSITION, attempts=1)
        disturbed += bus.counters.discarded_bytes > before
    if disturbed > MAX_DISTURBED:
        raise StartupError(
            f"several servos with the id {servo_id} answer at once, or a plug has bad contact: unplug all of them but "
            "one"
        )


def _changes(held: Mapping[Register, int], wanted: Mapping[Register, int]) -> tuple[Change, ...]:
    """Return the registers that differ; id and baud rate, by which the servo is reached, come last."""
    last = (Register.ID, Register.BAUD_RATE)
    ordered = [*(register for register in wanted if register not in last), *last]
    return tuple(
        Change(register, held[register], wanted[register])
        for register in ordered
        if register in wanted and held[register] != wanted[register]
    )
