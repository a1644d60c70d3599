"""The walk of docs/rehearsal.md on a pseudo terminal: a hand sweeps the emulated arm, and calibrate records it."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import pytest

from robot.calibration import Calibration
from server.commands.terminal import ExitCode
from tests.helpers.robots import SO101_SERVOS, nominal_calibration

NOMINAL = nominal_calibration()

# The rehearsal takes 17 s.
MOST_S = 90.0


class Shell:
    """Runs commands of armbridge as two people at two terminals do."""

    def __init__(self, resources: ExitStack) -> None:
        self._resources = resources

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        command = [sys.executable, "-m", "server.cli", *arguments]
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        self._resources.enter_context(process)
        self._resources.callback(process.kill)
        limit = threading.Timer(MOST_S, process.kill)
        limit.start()
        self._resources.callback(limit.cancel)
        return process


@pytest.fixture
def shell() -> Iterator[Shell]:
    with ExitStack() as resources:
        yield Shell(resources)


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


def test_an_arm_that_a_rehearsed_hand_sweeps_is_calibrated_with_its_true_ranges(shell: Shell, tmp_path: Path) -> None:
    file, link = tmp_path / "arm.json", tmp_path / "arm"
    emulator = shell.start("emulate", "--rehearse", "sweep", "--link", str(link))
    read_until(emulator.stdout, "/dev/")
    person = shell.start("calibrate", str(file), "--serial", str(link), "--yes", "--no-directions")
    read_until(person.stderr, "Move every joint")
    read_until(emulator.stderr, '"1": null')
    press_enter(person)
    read_until(person.stderr, "Turn wrist roll to the middle")
    press_enter(person)
    told, said = person.communicate()
    assert person.returncode == ExitCode.DONE, said
    calibration = Calibration.load(file, SO101_SERVOS)
    for joint, nominal in zip(calibration.joints, NOMINAL.joints, strict=True):
        assert (joint.range_min, joint.range_max) == pytest.approx((nominal.range_min, nominal.range_max), abs=3)
        assert str(joint.range_max) in told
