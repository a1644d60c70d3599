"""Fixtures: emulated servos in the test's own time or as a process."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.emulator import RunningEmulator
from robot.hardware.feetech.bus import Bus
from tests.helpers.emulator import SteppedEmulator


def starting(kind: Callable[..., Any]) -> Iterator[Callable[..., Any]]:
    """Starts emulated servos of a kind, and ends them."""
    with contextlib.ExitStack() as running:

        def start(*options: str) -> Any:
            emulator = kind(*options)
            running.callback(emulator.end)
            return emulator

        yield start


@pytest.fixture
def start_emulator() -> Iterator[Callable[..., SteppedEmulator]]:
    """Starts emulated servos in the test's own process and time."""
    yield from starting(SteppedEmulator)


@pytest.fixture
def emulator(start_emulator: Callable[..., SteppedEmulator]) -> SteppedEmulator:
    return start_emulator()


@pytest.fixture
def start_terminal() -> Iterator[Callable[..., RunningEmulator]]:
    """Starts emulated servos as a process on a pseudo terminal, in real time."""
    yield from starting(RunningEmulator)


@pytest.fixture
def terminal(start_terminal: Callable[..., RunningEmulator]) -> RunningEmulator:
    return start_terminal()


@pytest.fixture
def write_log(tmp_path: Path) -> Path:
    return tmp_path / "writes.jsonl"


@pytest.fixture
def bus(emulator: SteppedEmulator) -> Bus:
    return emulator.open_bus()
