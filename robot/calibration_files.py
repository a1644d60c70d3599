"""Where lerobot keeps calibration files, so that an arm may be named by its id, and writing one.

``$HF_LEROBOT_CALIBRATION/robots/<robot>/<id>.json``; without that variable ``$HF_LEROBOT_HOME/calibration/...``, and
without both ``~/.cache/huggingface/lerobot/calibration/...`` (lerobot's constants.py and robot.py).
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path

from robot.calibration import Calibration
from robot.errors import CalibrationError

# lerobot's names of the SO-101 follower: since January 2026, and before.
ROBOT_NAMES = ("so_follower", "so101_follower")


def lerobot_directories(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Directories in which lerobot keeps calibrations of this arm, the newer one first.

    Args:
        environment: the process's environment variables.
    """
    cache = environment.get("XDG_CACHE_HOME") or "~/.cache"
    huggingface = environment.get("HF_HOME") or f"{cache}/huggingface"
    home = environment.get("HF_LEROBOT_HOME") or f"{huggingface}/lerobot"
    directory = Path(environment.get("HF_LEROBOT_CALIBRATION") or f"{home}/calibration").expanduser()
    return tuple(directory / "robots" / name for name in ROBOT_NAMES)


def find_calibration(name_or_path: str, environment: Mapping[str, str]) -> Path:
    """The file that is meant: a path, or an arm's id as lerobot knows it.

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
    """Where a new calibration goes: to the path, or to where lerobot looks for that id."""
    if _is_path(name_or_path):
        return Path(name_or_path)
    return lerobot_directories(environment)[0] / f"{name_or_path}.json"


def save(calibration: Calibration, path: Path) -> None:
    """Write a calibration as lerobot does; the file is there wholly or not at all.

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
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(table, indent=4) + "\n")
        unfinished.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise CalibrationError(str(path), "", f"cannot be written: {error}") from error


def _is_path(name_or_path: str) -> bool:
    return "/" in name_or_path or name_or_path.endswith(".json") or Path(name_or_path).is_file()
