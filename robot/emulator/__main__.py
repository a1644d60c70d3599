"""``python -m robot.emulator``: run the emulated servo bus of an SO-101 on a pseudo terminal."""

from __future__ import annotations

import argparse
import contextlib
import random
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from robot.calibration import Calibration, JointCalibration
from robot.emulator.plant import Plant
from robot.emulator.process import Control, PseudoTerminal, serve
from robot.emulator.servo import Servo
from robot.emulator.wire import Faults, ServoBus
from robot.emulator.write_log import WriteLog
from robot.errors import CalibrationError

# Duty that holds a joint's weight [0.1 %]: the shoulder carries most; those not named carry next to nothing.
GRAVITY_PERMILLE = {"shoulder_lift": 60.0, "elbow_flex": 40.0, "wrist_flex": 15.0}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the emulator and return the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        calibration = Calibration.load(options.calibration) if options.calibration else Calibration.nominal()
        servos = build_servos(calibration, options.start)
        log = WriteLog(options.write_log) if options.write_log else None
        terminal = PseudoTerminal(options.link)
    except (CalibrationError, ValueError, OSError) as error:
        parser.error(str(error))
    _end_on_signals(controlled=options.control_fd is not None)
    chance = random.Random(options.seed)  # noqa: S311 - repeatable faults, no secret
    bus = ServoBus(servos, Faults(options.drop, options.corrupt, random=chance), time.monotonic(), log)
    with contextlib.closing(terminal), contextlib.closing(log) if log else contextlib.nullcontext():
        if options.control_fd is None:
            print(terminal.port, flush=True)  # noqa: T201 - the program's output
            serve(terminal, bus, None)
        else:
            serve(terminal, bus, Control(options.control_fd))
    return 0


def build_servos(calibration: Calibration, start_rad: Sequence[float]) -> list[Servo]:
    """Build the arm's servos at a pose.

    Args:
        calibration: ids, angle limits and homing offsets; its ranges are the joints' mechanical stops.
        start_rad: position of each joint of the calibration, in its order [rad].

    Raises:
        ValueError: the pose has another number of joints, or lies outside the ranges.
    """
    if len(start_rad) != len(calibration.joints):
        raise ValueError(f"the start pose needs {len(calibration.joints)} positions, not {len(start_rad)}")
    return [_servo(joint, position) for joint, position in zip(calibration.joints, start_rad, strict=True)]


def _servo(joint: JointCalibration, start_rad: float) -> Servo:
    if not joint.lower_rad <= start_rad <= joint.upper_rad:
        raise ValueError(
            f"{joint.joint} cannot start at {start_rad:g} rad, outside its range of "
            f"{joint.lower_rad:.3f} to {joint.upper_rad:.3f}"
        )
    offset = joint.homing_offset
    plant = Plant(
        position_ticks=joint.ticks_from_rad(start_rad) + offset,
        lower_stop_ticks=joint.range_min + offset,
        upper_stop_ticks=joint.range_max + offset,
        gravity_permille=GRAVITY_PERMILLE.get(joint.joint, 0.0),
    )
    return Servo(joint.servo_id, plant, (joint.range_min, joint.range_max), offset)


def _end_on_signals(*, controlled: bool) -> None:
    """End in good order on SIGTERM and Ctrl-C; a controlled emulator leaves Ctrl-C to its controller."""

    def end(_number: int, _frame: FrameType | None) -> None:
        sys.exit(0)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, signal.SIG_IGN if controlled else end)


def _probability(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not a probability from 0 to 1")
    return value


def _positions(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m robot.emulator",
        description="Emulate the servo bus of an SO-101 on a pseudo terminal and print the terminal's path.",
    )
    parser.add_argument(
        "--drop", type=_probability, default=0.0, metavar="P", help="lose a reply with this probability"
    )
    parser.add_argument(
        "--corrupt", type=_probability, default=0.0, metavar="P", help="damage a reply with this probability"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of these faults (default 0)")
    parser.add_argument(
        "--start",
        type=_positions,
        default=[0.0] * 6,
        metavar="Q1,..,Q6",
        help="joint positions at power-up in rad, base to gripper; default all 0",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="lerobot calibration of the arm (default: an ideal arm)",
    )
    parser.add_argument("--write-log", type=Path, metavar="FILE", help="record every write here, one JSON line each")
    parser.add_argument("--link", type=Path, metavar="PATH", help="make a symbolic link to the terminal here")
    parser.add_argument(
        "--control-fd",
        type=int,
        metavar="N",
        help="inherited socket: announce the port there, take live commands, end when the other side is gone",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
