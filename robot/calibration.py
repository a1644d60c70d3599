"""Calibration of the arm as lerobot writes it: conversion between servo ticks and the URDF's radians.

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
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from robot import files
from robot.errors import CalibrationError

TICKS_PER_TURN = 4096
MAX_TICK = TICKS_PER_TURN - 1
RAD_PER_TICK = 2.0 * math.pi / TICKS_PER_TURN

# Register HOMING_OFFSET has 11 bits and a sign.
MAX_HOMING_OFFSET = 2047

# Distance of an ideal arm's end stops beyond the URDF's limits, which it can thus reach. The gripper's range is the
# URDF's by definition.
NOMINAL_OVERTRAVEL_RAD = 0.05

# A zero trim corrects an arm whose range is a little off the URDF's (20 deg at most on measured arms); a larger one
# hides a wrong calibration.
MAX_ZERO_OFFSET_RAD = 0.5

# Wider ranges come near the seam between tick 4095 and 0, where positions jump by a turn.
WIDEST_RANGE_TICKS = 4000

# 254 is the broadcast id.
MAX_SERVO_ID = 253

GRIPPER_JOINT = "gripper"

# lerobot turns this joint freely while it records the others, and writes 0..4095 for it.
FREE_TURNING_JOINT = "wrist_roll"

# lerobot's names of the SO-101 follower: since January 2026, and before.
ROBOT_NAMES = ("so_follower", "so101_follower")


@dataclass(frozen=True)
class JointSpec:
    """Joint of the SO-101 as in its URDF (so101_new_calib); limits in rad."""

    name: str
    servo_id: int
    lower_rad: float
    upper_rad: float


SO101_JOINTS = (
    JointSpec("shoulder_pan", 1, -1.91986, 1.91986),
    JointSpec("shoulder_lift", 2, -1.74533, 1.74533),
    JointSpec("elbow_flex", 3, -1.69, 1.69),
    JointSpec("wrist_flex", 4, -1.65806, 1.65806),
    JointSpec("wrist_roll", 5, -2.74385, 2.84121),
    JointSpec(GRIPPER_JOINT, 6, -0.174533, 1.74533),
)
_GRIPPER = SO101_JOINTS[-1]


@dataclass(frozen=True)
class JointCalibration:
    """Calibration of one joint: conversion between ticks and radians.

    An arm joint turns by its ticks: ``q = (ticks - middle) * 2 pi / 4096 + zero_offset_rad``. The gripper's
    range spans the URDF's, closed to open: ``q = lower + (ticks - range_min) / (range_max - range_min) *
    (upper - lower)``, and ``drive_mode`` 1 swaps its ends. lerobot ignores ``drive_mode`` of arm joints in
    degrees, and so does this class.

    Attributes:
        joint: name in the URDF.
        servo_id: id on the bus.
        drive_mode: 0, or 1 for a mirrored gripper.
        homing_offset: register HOMING_OFFSET at calibration [ticks]; the servo applies it itself.
        range_min: lowest position reached by hand [ticks].
        range_max: highest position reached by hand [ticks].
        zero_offset_rad: trim added to an arm joint's position [rad].
    """

    joint: str
    servo_id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int
    zero_offset_rad: float = 0.0

    @property
    def is_gripper(self) -> bool:
        """True for the joint that opens and closes the jaw."""
        return self.joint == GRIPPER_JOINT

    @property
    def lower_rad(self) -> float:
        """Lower end of the calibrated range [rad]."""
        return min(self.rad_from_ticks(self.range_min), self.rad_from_ticks(self.range_max))

    @property
    def upper_rad(self) -> float:
        """Upper end of the calibrated range [rad]."""
        return max(self.rad_from_ticks(self.range_min), self.rad_from_ticks(self.range_max))

    def rad_from_ticks(self, ticks: float) -> float:
        """Convert a present position [ticks] to a joint position [rad]."""
        return self._zero_rad + (ticks - self._zero_ticks) * self._rad_per_tick

    def ticks_from_rad(self, position_rad: float) -> int:
        """Convert a joint position [rad] to the nearest tick, inside the range or not.

        Raises:
            ValueError: the position is not a number.
            OverflowError: the position is infinite.
        """
        return round(self._zero_ticks + (position_rad - self._zero_rad) / self._rad_per_tick)

    def rad_s_from_ticks_s(self, velocity_ticks_s: float) -> float:
        """Convert a servo velocity [ticks/s] to a joint velocity [rad/s]."""
        return velocity_ticks_s * self._rad_per_tick

    def ticks_s_from_rad_s(self, velocity_rad_s: float) -> float:
        """Convert a joint velocity [rad/s] to a servo velocity [ticks/s]."""
        return velocity_rad_s / self._rad_per_tick

    @property
    def _zero_ticks(self) -> float:
        """Tick at ``_zero_rad``: the closed end of the gripper, the middle of an arm joint."""
        if self.is_gripper:
            return self.range_max if self.drive_mode else self.range_min
        return (self.range_min + self.range_max) / 2.0

    @property
    def _zero_rad(self) -> float:
        return _GRIPPER.lower_rad if self.is_gripper else self.zero_offset_rad

    @property
    def _rad_per_tick(self) -> float:
        if not self.is_gripper:
            return RAD_PER_TICK
        scale = (_GRIPPER.upper_rad - _GRIPPER.lower_rad) / (self.range_max - self.range_min)
        return -scale if self.drive_mode else scale


@dataclass(frozen=True)
class Calibration:
    """Calibration of an arm: its joints from base to gripper."""

    joints: tuple[JointCalibration, ...]

    @classmethod
    def nominal(cls) -> Calibration:
        """Build the calibration of an ideal arm: every range centred, and a little wider than the URDF's limits."""
        return cls(tuple(_nominal(spec) for spec in SO101_JOINTS))

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """Read a calibration file of lerobot (June 2025 or later).

        Raises:
            CalibrationError: the file cannot be read, has the older schema, or does not describe this arm.
        """
        table = _read_table(path)
        names = [spec.name for spec in SO101_JOINTS]
        if missing := [name for name in names if name not in table]:
            raise CalibrationError(str(path), missing[0], f"the joint is missing; the file has {sorted(table)}")
        if unknown := [name for name in table if name not in names]:
            raise CalibrationError(str(path), unknown[0], f"the SO-101 has no such joint, but {names}")
        joints = tuple(_joint(str(path), name, table[name]) for name in names)
        _check_ids(str(path), joints)
        return cls(joints)

    def with_zero_offsets(self, zero_offset_rad: Mapping[str, float]) -> Calibration:
        """Return the calibration with a trim of some joints' zero.

        Args:
            zero_offset_rad: offset to add to a joint's position, by joint [rad]; joints not named keep theirs.

        Raises:
            CalibrationError: there is no such joint, it is the gripper, or the trim is too large.
        """
        names = [joint.joint for joint in self.joints if not joint.is_gripper]
        for name, offset_rad in zero_offset_rad.items():
            if name not in names:
                raise CalibrationError("zero_offset_rad", name, f"must be one of the arm's joints, {', '.join(names)}")
            if not abs(offset_rad) <= MAX_ZERO_OFFSET_RAD:
                raise CalibrationError(
                    "zero_offset_rad", name, f"must be within +-{MAX_ZERO_OFFSET_RAD} rad, not {offset_rad}"
                )
        return Calibration(
            tuple(
                replace(joint, zero_offset_rad=zero_offset_rad.get(joint.joint, joint.zero_offset_rad))
                for joint in self.joints
            )
        )

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about a calibration that is usable but looks wrong, a sentence each."""
        return tuple(
            f"{joint.joint} has a range of {joint.range_max - joint.range_min} ticks, more than {WIDEST_RANGE_TICKS}: "
            "its sweep went across the seam between 4095 and 0; calibrate anew from the middle of the joint's range"
            for joint in self.joints
            if joint.joint != FREE_TURNING_JOINT and joint.range_max - joint.range_min > WIDEST_RANGE_TICKS
        )


def find_calibration(name_or_path: str, environment: Mapping[str, str]) -> Path:
    """Find a calibration file.

    Args:
        name_or_path: path of the file, or the arm's lerobot id.
        environment: the process's environment variables.

    Raises:
        CalibrationError: lerobot has no calibration of that id, or one under each of its names that differ.
    """
    if _is_path(name_or_path):
        return Path(name_or_path)
    candidates = [directory / f"{name_or_path}.json" for directory in lerobot_directories(environment)]
    found = [path for path in candidates if path.is_file()]
    if not found:
        places = " or ".join(str(path) for path in candidates)
        raise CalibrationError(name_or_path, "", f"is no file, and lerobot has none of that id: {places}")
    if len({path.read_bytes() for path in found}) > 1:
        raise CalibrationError(name_or_path, "", f"is ambiguous, name one: {' or '.join(str(path) for path in found)}")
    return found[0]


def new_calibration_path(name_or_path: str, environment: Mapping[str, str]) -> Path:
    """Return the file of a new calibration: the path, or the file in which lerobot looks for that id.

    Args:
        name_or_path: path of the file, or the arm's lerobot id.
        environment: the process's environment variables.
    """
    if _is_path(name_or_path):
        return Path(name_or_path)
    return lerobot_directories(environment)[0] / f"{name_or_path}.json"


def lerobot_directories(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Return the directories in which lerobot keeps calibrations of this arm, the newer one first.

    Args:
        environment: the process's environment variables.
    """
    cache = environment.get("XDG_CACHE_HOME") or "~/.cache"
    huggingface = environment.get("HF_HOME") or f"{cache}/huggingface"
    home = environment.get("HF_LEROBOT_HOME") or f"{huggingface}/lerobot"
    directory = Path(environment.get("HF_LEROBOT_CALIBRATION") or f"{home}/calibration").expanduser()
    return tuple(directory / "robots" / name for name in ROBOT_NAMES)


@contextlib.contextmanager
def reserved(path: Path, *, overwrite: bool) -> Iterator[None]:
    """Reserve a file for a new calibration, against other processes that would write it meanwhile.

    Args:
        path: the file.
        overwrite: True if it may exist.

    Raises:
        CalibrationError: it exists, cannot be written, or another process has it.
    """
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
    """Write a calibration as lerobot does, as a whole or not at all; its file is :func:`reserved`.

    Raises:
        CalibrationError: the file cannot be written.
    """
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


def _nominal(spec: JointSpec) -> JointCalibration:
    middle = MAX_TICK / 2.0
    overtravel_rad = 0.0 if spec.name == GRIPPER_JOINT else NOMINAL_OVERTRAVEL_RAD
    half_width = ((spec.upper_rad - spec.lower_rad) / 2.0 + overtravel_rad) / RAD_PER_TICK
    range_min, range_max = math.floor(middle - half_width), math.ceil(middle + half_width)
    if spec.name == FREE_TURNING_JOINT:
        range_min, range_max = 0, MAX_TICK
    return JointCalibration(spec.name, spec.servo_id, 0, 0, range_min, range_max)


def _read_table(path: Path) -> Mapping[str, object]:
    try:
        table = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise CalibrationError(str(path), "", f"cannot be read: {error}") from error
    if not isinstance(table, dict):
        raise CalibrationError(str(path), "", "must be a JSON object with one entry per joint")
    if "calib_mode" in table or isinstance(table.get("homing_offset"), list):
        raise CalibrationError(
            str(path),
            "",
            "is of lerobot's schema before June 2025, whose zero is another: calibrate the arm anew",
        )
    return table


def _joint(file: str, name: str, entry: object) -> JointCalibration:
    if not isinstance(entry, dict):
        raise CalibrationError(file, name, "must be an object with id, drive_mode, homing_offset and the range")

    def number(key: str, lowest: int, highest: int) -> int:
        """Return a whole number of the entry, checked against its range."""
        value = entry.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
            raise CalibrationError(
                file, f"{name}.{key}", f"must be a whole number {lowest} to {highest}, not {value!r}"
            )
        return value

    range_min, range_max = number("range_min", 0, MAX_TICK), number("range_max", 0, MAX_TICK)
    if range_min >= range_max:
        raise CalibrationError(
            file,
            f"{name}.range_min",
            f"must be below range_max {range_max}, not {range_min}: calibrate the arm anew",
        )
    return JointCalibration(
        joint=name,
        servo_id=number("id", 0, MAX_SERVO_ID),
        drive_mode=number("drive_mode", 0, 1),
        homing_offset=number("homing_offset", -MAX_HOMING_OFFSET, MAX_HOMING_OFFSET),
        range_min=range_min,
        range_max=range_max,
    )


def _check_ids(file: str, joints: tuple[JointCalibration, ...]) -> None:
    owners: dict[int, str] = {}
    for joint in joints:
        other = owners.setdefault(joint.servo_id, joint.joint)
        if other != joint.joint:
            raise CalibrationError(file, f"{joint.joint}.id", f"{joint.servo_id} is the id of {other} as well")


def _is_path(name_or_path: str) -> bool:
    return "/" in name_or_path or name_or_path.endswith(".json") or Path(name_or_path).is_file()
