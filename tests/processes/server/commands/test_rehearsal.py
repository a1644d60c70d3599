"""The walk of docs/simulation.md on a pseudo terminal: a hand sweeps the emulated arm, and calibrate records it."""

import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO

import pytest

from harness.waiting import TIMEOUT_S, running
from robot.calibration import Calibration
from server.commands.terminal import ExitCode
from tests.helpers.robots import SO101_SERVOS, nominal_calibration

NOMINAL = nominal_calibration()


def armbridge(*arguments: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """Run a command of armbridge at a terminal of its own."""
    pipe = subprocess.PIPE
    return running([sys.executable, "-m", "server.cli", *arguments], stdin=pipe, stdout=pipe, stderr=pipe)


def read_until(stream: IO[str] | None, words: str) -> None:
    assert stream is not None
    said = []
    for line in stream:
        said.append(line)
        if words in line:
            return
    raise AssertionError("".join(said))


def press_enter(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def test_an_arm_that_a_rehearsed_hand_sweeps_is_calibrated_with_its_true_ranges(tmp_path: Path) -> None:
    file, link = tmp_path / "arm.json", tmp_path / "arm"
    with armbridge("emulate", "--rehearse", "sweep", "--link", str(link)) as emulator:
        read_until(emulator.stdout, "/dev/")
        with armbridge("calibrate", str(file), "--serial", str(link), "--yes", "--no-directions") as person:
            read_until(person.stderr, "Move every joint")
            read_until(emulator.stderr, '"1": null')
            press_enter(person)
            read_until(person.stderr, "Turn wrist roll to the middle")
            press_enter(person)
            told, said = person.communicate(timeout=TIMEOUT_S)
    assert person.returncode == ExitCode.DONE, said
    calibration = Calibration.load(file, SO101_SERVOS)
    for joint, nominal in zip(calibration.joints, NOMINAL.joints, strict=True):
        assert (joint.range_min, joint.range_max) == pytest.approx((nominal.range_min, nominal.range_max), abs=3)
        assert str(joint.range_max) in told
