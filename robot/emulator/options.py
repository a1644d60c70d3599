"""The emulator's command line, for ``python -m robot.emulator`` and ``armbridge emulate`` alike."""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from robot.calibration import Calibration
from robot.emulator.adapter import UsbAdapter
from robot.emulator.arm import build_servos, weight_of
from robot.emulator.commands import MAX_DELAY_S, MAX_HEAT_RATE, MAX_USB_FRAME_MS, MAX_VOLTAGE_V, Emulation
from robot.emulator.faults import DELAY_S, PROBABILITIES, Faults
from robot.emulator.servo import SUPPLY_V, Servo
from robot.emulator.servo_bus import ServoBus
from robot.emulator.write_log import WriteLog

# One joint position each.
JOINTS = 6


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser; :func:`build` takes what it parses."""
    for name, meaning in PROBABILITIES.items():
        parser.add_argument(
            _option(name), type=_probability, default=0.0, metavar="P", help=f"{meaning} with this probability"
        )
    add = parser.add_argument
    add("--delay-s", type=_number(MAX_DELAY_S), default=DELAY_S, metavar="T", help="how long --delay takes [s]")
    add("--seed", type=int, default=0, metavar="N", help="seed of these faults (default 0)")
    add("--usb-frame-ms", type=_number(MAX_USB_FRAME_MS), default=0.0, metavar="T", help="hand replies on so often")
    add("--stall-behind-missing", action="store_true", help="end a sync read at the first servo that is missing")
    add("--supply", type=_number(MAX_VOLTAGE_V), default=SUPPLY_V, metavar="V", help="supply [V] (default 5)")
    add("--heat-rate", type=_number(MAX_HEAT_RATE), default=1.0, metavar="X", help="warm and cool X times faster")
    add("--overload-latches", action="store_true", help="let only a power cycle clear an overload")
    add("--powers-up-holding", action="store_true", help="power up with torque on, at the present position")
    add(
        "--start",
        type=_positions,
        default=[0.0] * JOINTS,
        metavar="Q1,..,Q6",
        help="joint positions at power-up in rad, base to gripper; default all 0",
    )
    add("--calibration", type=Path, metavar="FILE", help="lerobot calibration of the arm (default: an ideal arm)")
    add("--write-log", type=Path, metavar="FILE", help="record every write here, one JSON line each")
    add("--link", type=Path, metavar="PATH", help="make a symbolic link to the terminal here")


def build(options: argparse.Namespace, resources: ExitStack) -> Emulation:
    """Build what the options ask for.

    Args:
        options: as parsed.
        resources: gets what must be closed.

    Raises:
        CalibrationError: the calibration cannot be used.
        ValueError: the start pose is not one.
        OSError: the log cannot be written, or there is no terminal to be had.
    """
    calibration = Calibration.load(options.calibration) if options.calibration else Calibration.nominal()
    servos = build_servos(calibration, options.start)
    for servo in servos:
        _temper(servo, options)
    log = None
    if options.write_log:
        log = WriteLog(options.write_log)
        resources.callback(log.close)
    adapter = UsbAdapter(options.link, options.usb_frame_ms / 1000.0)
    resources.callback(adapter.unplug)
    bus = ServoBus(servos, _faults(options), time.monotonic(), log, weight_of(calibration, servos))
    return Emulation(bus, adapter)


def _faults(options: argparse.Namespace) -> Faults:
    chance = random.Random(options.seed)  # noqa: S311 - repeatable faults, no secret
    probabilities = {name: getattr(options, name) for name in PROBABILITIES}
    stall = options.stall_behind_missing
    return Faults(**probabilities, delay_s=options.delay_s, stall_behind_missing=stall, random=chance)


def _temper(servo: Servo, options: argparse.Namespace) -> None:
    """Make a servo one of the kinds that there are, and power it up as such."""
    servo.voltage_v = options.supply
    servo.motor.rate = options.heat_rate
    servo.protection.latches = options.overload_latches
    servo.powers_up_holding = options.powers_up_holding
    servo.power_up()


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


def _probability(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not a probability from 0 to 1")
    return value


def _number(highest: float) -> Callable[[str], float]:
    def number(text: str) -> float:
        value = float(text)
        if not 0.0 <= value <= highest:
            raise argparse.ArgumentTypeError(f"{text} is not a number from 0 to {highest:g}")
        return value

    return number


def _positions(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers") from error
