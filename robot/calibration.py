"""Calibration of the arm as lerobot writes it: conversion between servo ticks and the URDF's radians.

A calibration that cannot be found, read, written or used raises CalibrationError.

lerobot records for each joint the ticks of its two ends. The middle of that range is the URDF's zero: on four
measured arms the elbow's range agrees with the URDF's within 0.8 deg, while its middle lies up to 13.5 deg
from tick 2048.

An arm may be named by its lerobot id. Its file is ``$HF_LEROBOT_CALIBRATION/robots/<robot>/<id>.json``; without that
variable ``$HF_LEROBOT_HOME/calibration/...``, and without both ``~/.cache/huggingface/lerobot/calibration/...``
(lerobot's constants.py and robot.py).
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from robot import files
from robot.description.servo_table import MAX_SERVO_ID, ServoSpec
from robot.errors import CalibrationError

TICKS_PER_TURN = 4096
MAX_TICK = TICKS_PER_TURN - 1
RAD_PER_TICK = 2.0 * math.pi / TICKS_PER_TURN

# Distance of an ideal arm's end stops beyond the URDF's limits, which it can thus reach. The gripper's range is the
# URDF's by definition.
NOMINAL_OVERTRAVEL_RAD = 0.05

# A zero trim corrects an arm whose range is a little off the URDF's (20 deg at most on measured arms); a larger one
# hides a wrong calibration.
MAX_ZERO_OFFSET_RAD = 0.5

WIDEST_RANGE_TICKS = 4000  # wider ranges come near the seam between tick 4095 and 0, where positions jump by a turn


@dataclass(frozen=True)
class JointCalibration:
    """Calibration of one joint: conversion between ticks and radians.

    A joint whose zero is a tick turns by its ticks: ``q = sign * (ticks - tick) * 2 pi / 4096 + angle_rad +
    zero_offset_rad``. The range of one whose zero is given by its ``ends`` spans the URDF's: ``q = lower + (ticks -
    range_min) / (range_max - range_min) * (upper - lower)``, and ``drive_mode`` 1 swaps its ends, as the sign -1 does.
    lerobot ignores ``drive_mode`` of joints in degrees, and so does this class.
    """

    servo: ServoSpec
    servo_id: int
    drive_mode: int  # 0, or 1 for a mirrored gripper
    homing_offset: int  # register HOMING_OFFSET at calibration [ticks]; the servo applies it itself
    range_min: int  # lowest position reached by hand [ticks]
    range_max: int  # highest position reached by hand [ticks]
    zero_offset_rad: float = 0.0  # trim added to the position of a joint whose zero is a tick [rad]

    @property
    def joint(self) -> str:
        return self.servo.joint

    @property
    def lower_rad(self) -> float:
        return min(self.rad_from_ticks(self.range_min), self.rad_from_ticks(self.range_max))

    @property
    def upper_rad(self) -> float:
        return max(self.rad_from_ticks(self.range_min), self.rad_from_ticks(self.range_max))

    def rad_from_ticks(self, ticks: float) -> float:
        return self._zero_rad + (ticks - self._zero_ticks) * self._rad_per_tick

    def ticks_from_rad(self, position_rad: float) -> int:
        """Convert a joint position [rad] to the nearest tick, inside the range or not."""
        return round(self._zero_ticks + (position_rad - self._zero_rad) / self._rad_per_tick)

    def rad_s_from_ticks_s(self, velocity_ticks_s: float) -> float:
        return velocity_ticks_s * self._rad_per_tick

    def ticks_s_from_rad_s(self, velocity_rad_s: float) -> float:
        return velocity_rad_s / self._rad_per_tick

    @property
    def _mirrored(self) -> bool:
        """True when the range's higher tick is the joint's lower limit."""
        return (self.drive_mode == 1) != (self.servo.sign < 0)

    @property
    def _zero_ticks(self) -> float:
        if self.servo.zero == "ends":
            return self.range_max if self._mirrored else self.range_min
        return (self.range_min + self.range_max) / 2.0 if self.servo.zero.tick is None else self.servo.zero.tick

    @property
    def _zero_rad(self) -> float:
        if self.servo.zero == "ends":
            return self.servo.lower_rad
        return self.servo.zero.angle_rad + self.zero_offset_rad

    @property
    def _rad_per_tick(self) -> float:
        if self.servo.zero != "ends":
            return self.servo.sign * RAD_PER_TICK
        scale = (self.servo.upper_rad - self.servo.lower_rad) / (self.range_max - self.range_min)
        return -scale if self._mirrored else scale


@dataclass(frozen=True)
class Calibration:
    """Calibration of an arm."""

    joints: tuple[JointCalibration, ...]  # its joints from base to gripper
    measured: bool = field(default=True, compare=False)  # False if it was assumed rather than read from a file
    # False if it does not say which homing offsets the servos should have.
    offsets_known: bool = field(default=True, compare=False)

    @property
    def zero_is_known(self) -> bool:
        """True when the place of every joint's zero was measured, or is given by the robot's folder."""
        return self.measured or not any(joint.servo.needs_calibration for joint in self.joints)

    @classmethod
    def nominal(cls, servos: Sequence[ServoSpec]) -> Calibration:
        """Build the calibration of a flawless arm: every range centred, and a little wider than the URDF's limits."""
        return cls(tuple(_nominal(servo) for servo in servos), measured=False, offsets_known=False)

    @classmethod
    def load(cls, path: Path, servos: Sequence[ServoSpec]) -> Calibration:
        """Read a calibration file of lerobot (June 2025 or later)."""
        table = _read_table(path)
        names = [servo.joint for servo in servos]
        if missing := [name for name in names if name not in table]:
            raise CalibrationError(str(path), missing[0], f"the joint is missing; the file has {sorted(table)}")
        if unknown := [name for name in table if name not in names]:
            raise CalibrationError(str(path), unknown[0], f"the arm has no such joint, but {names}")
        joints = tuple(_joint(str(path), servo, table[servo.joint]) for servo in servos)
        owners: dict[int, str] = {}
        for joint in joints:
            if (other := owners.setdefault(joint.servo_id, joint.joint)) != joint.joint:
                raise CalibrationError(str(path), f"{joint.joint}.id", f"{joint.servo_id} is the id of {other} as well")
        return cls(joints)

    def with_zero_offsets(self, zero_offset_rad: Mapping[str, float]) -> Calibration:
        """Return the calibration with a trim added to the positions of some joints, by joint [rad]."""
        names = [joint.joint for joint in self.joints if joint.servo.zero != "ends"]
        for name, offset_rad in zero_offset_rad.items():
            if name not in names:
                raise CalibrationError("zero_offset_rad", name, f"must be one of the arm's joints, {', '.join(names)}")
            if not abs(offset_rad) <= MAX_ZERO_OFFSET_RAD:
                raise CalibrationError(
                    "zero_offset_rad", name, f"must be within +-{MAX_ZERO_OFFSET_RAD} rad, not {offset_rad}"
                )
        return replace(
            self,
            joints=tuple(
                replace(joint, zero_offset_rad=zero_offset_rad.get(joint.joint, joint.zero_offset_rad))
                for joint in self.joints
            ),
        )

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about a calibration that is usable but looks wrong, a sentence each."""
        return tuple(
            f"{joint.joint} has a range of {joint.range_max - joint.range_min} ticks, more than {WIDEST_RANGE_TICKS}: "
            "its sweep went across the seam between 4095 and 0; calibrate again from the middle of the joint's range"
            for joint in self.joints
            if not joint.servo.turns_freely and joint.range_max - joint.range_min > WIDEST_RANGE_TICKS
        )


def find_calibration(name_or_path: str, folders: Sequence[str], environment: Mapping[str, str]) -> Path:
    """Find a calibration file by its path, or by the arm's lerobot id in lerobot's folders, the newest first."""
    if _is_path(name_or_path):
        return Path(name_or_path)
    candidates = [directory / f"{name_or_path}.json" for directory in lerobot_directories(folders, environment)]
    found = [path for path in candidates if path.is_file()]
    if not folders:
        raise CalibrationError(name_or_path, "", "is no file, and lerobot has no calibrations of this arm: name a file")
    if not found:
        places = " or ".join(str(path) for path in candidates)
        raise CalibrationError(name_or_path, "", f"is no file, and lerobot has no calibration of that id: {places}")
    if len({path.read_bytes() for path in found}) > 1:
        raise CalibrationError(name_or_path, "", f"is ambiguous, name one: {' or '.join(str(path) for path in found)}")
    return found[0]


def new_calibration_path(name_or_path: str, folders: Sequence[str], environment: Mapping[str, str]) -> Path:
    """Return the file of a new calibration: the path, or the file in which lerobot looks for that id."""
    if _is_path(name_or_path):
        return Path(name_or_path)
    if not folders:
        raise CalibrationError(name_or_path, "", "is no path, and lerobot has no place for this arm: name a .json file")
    return lerobot_directories(folders, environment)[0] / f"{name_or_path}.json"


def lerobot_directories(folders: Sequence[str], environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Return the directories in which lerobot keeps calibrations of the arm, the newest first."""
    cache = environment.get("XDG_CACHE_HOME") or "~/.cache"
    huggingface = environment.get("HF_HOME") or f"{cache}/huggingface"
    home = environment.get("HF_LEROBOT_HOME") or f"{huggingface}/lerobot"
    directory = Path(environment.get("HF_LEROBOT_CALIBRATION") or f"{home}/calibration").expanduser()
    return tuple(directory / "robots" / name for name in folders)


@contextlib.contextmanager
def reserved(path: Path, *, overwrite: bool) -> Iterator[None]:
    """Reserve a file for a new calibration, against other processes that would write it meanwhile."""
    lock = files.FileLock(path)
    try:
        lock.acquire()
    except files.FileLockedError as error:
        raise CalibrationError(str(path), "", f"{error.strerror}, which is calibrating this arm") from error
    except OSError as error:
        raise CalibrationError(str(path), "", f"cannot be written: {error}") from error
    try:
        if path.exists() and not overwrite:
            raise CalibrationError(str(path), "", "is there already: choose another name, or --overwrite it")
        yield
    finally:
        lock.release()


def save(calibration: Calibration, path: Path) -> None:
    """Write a calibration as lerobot does, completely or not; its file is :func:`reserved`."""
    table = {
        joint.joint: {
            "id": joint.servo_id,
            "drive_mode": joint.drive_mode,
            "homing_offset": joint.homing_offset,
            "range_min": joint.range_min,
            "range_max": joint.range_max,
        }
        for joint in calibration.joints
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        files.replace(path, (json.dumps(table, indent=4) + "\n").encode())
    except OSError as error:
        raise CalibrationError(str(path), "", f"cannot be written: {error}") from error


def _nominal(servo: ServoSpec) -> JointCalibration:
    middle = MAX_TICK / 2.0
    overtravel_rad = 0.0 if servo.zero == "ends" else NOMINAL_OVERTRAVEL_RAD
    half_width = ((servo.upper_rad - servo.lower_rad) / 2.0 + overtravel_rad) / RAD_PER_TICK
    if servo.zero != "ends" and servo.zero.tick is not None:
        middle_rad = (servo.lower_rad + servo.upper_rad) / 2.0
        middle = servo.zero.tick + servo.sign * (middle_rad - servo.zero.angle_rad) / RAD_PER_TICK
    range_min, range_max = max(math.floor(middle - half_width), 0), min(math.ceil(middle + half_width), MAX_TICK)
    if servo.turns_freely:
        range_min, range_max = 0, MAX_TICK
    return JointCalibration(servo, servo.servo_id, 0, 0, range_min, range_max)


def _read_table(path: Path) -> Mapping[str, object]:
    try:
        table = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise CalibrationError(str(path), "", f"cannot be read: {error}") from error
    if not isinstance(table, dict):
        raise CalibrationError(str(path), "", "must be a JSON object with one entry per joint")
    if "calib_mode" in table or isinstance(table.get("homing_offset"), list):
        raise CalibrationError(
            str(path), "", "is of lerobot's schema before June 2025, whose zero is another: calibrate the arm again"
        )
    return table


def _joint(file: str, servo: ServoSpec, entry: object) -> JointCalibration:
    name = servo.joint
    if not isinstance(entry, dict):
        raise CalibrationError(file, name, "must be an object with id, drive_mode, homing_offset and the range")

    def number(key: str, lowest: int, highest: int) -> int:
        value = entry.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
            raise CalibrationError(
                file, f"{name}.{key}", f"must be a whole number {lowest} to {highest}, not {value!r}"
            )
        return value

    most = servo.max_homing_offset
    range_min, range_max = number("range_min", 0, MAX_TICK), number("range_max", 0, MAX_TICK)
    if range_min >= range_max:
        raise CalibrationError(
            file, f"{name}.range_min", f"must be below range_max {range_max}, not {range_min}: calibrate the arm again"
        )
    return JointCalibration(
        servo=servo,
        servo_id=number("id", 0, MAX_SERVO_ID),
        drive_mode=number("drive_mode", 0, 1),
        homing_offset=number("homing_offset", -most, most),
        range_min=range_min,
        range_max=range_max,
    )


def _is_path(name_or_path: str) -> bool:
    return "/" in name_or_path or name_or_path.endswith(".json") or Path(name_or_path).is_file()
