"""Commands run as they do for people, in the test's process on stepped servos."""

import contextlib
import functools
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robot.description import robot_folder
from robot.emulator.servo_bus import BAUDRATE
from robot.hardware.feetech.bus import Bus
from robot.hardware.interface import run_to_end
from server import cli
from server.commands import arm as arm_module
from server.commands import calibrate as calibrate_module
from server.commands import options as command_options
from server.commands.terminal import Terminal
from tests.helpers.emulator import SteppedEmulator


@pytest.fixture(autouse=True, scope="session")
def shapes_are_read_once() -> Iterator[None]:
    """Every command reads its arm's description; most of the time goes into the shapes of the links."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("_hulls", "_parts"):
            patch.setattr(robot_folder, name, functools.cache(getattr(robot_folder, name)))
        yield


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def emulator(start_emulator: Callable[..., SteppedEmulator], write_log: Path) -> SteppedEmulator:
    return start_emulator("--write-log", str(write_log))


@pytest.fixture
def armbridge(emulator: SteppedEmulator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command on the emulator's servos, which are there on every port, with lines for its questions."""

    def open_bus(_port: str, baudrate: int = BAUDRATE) -> Bus:
        emulator.port.baudrate = baudrate
        return emulator.open_bus()

    monkeypatch.setattr(Bus, "open", open_bus)
    # Torque is lowered in the servos' time.
    for module in (arm_module, calibrate_module):
        monkeypatch.setattr(module, "run_to_end", functools.partial(run_to_end, wait=emulator.run))

    def run(
        command: str, *options: str, answers: str = "", descriptor: int | None = None
    ) -> subprocess.CompletedProcess[str]:
        capsys.readouterr()
        with typed(answers) as answering:
            made = functools.partial(Terminal, answering if descriptor is None else descriptor)
            monkeypatch.setattr(command_options, "Terminal", made)
            code = cli.main([command, "--serial", "/dev/stepped", *options])
        said = capsys.readouterr()
        return subprocess.CompletedProcess([command], code, said.out, said.err)

    return run


@contextlib.contextmanager
def typed(lines: str) -> Iterator[int]:
    """The descriptor of an input that has these lines and then ends."""
    read_end, write_end = os.pipe()
    os.write(write_end, lines.encode())
    os.close(write_end)
    try:
        yield read_end
    finally:
        os.close(read_end)
