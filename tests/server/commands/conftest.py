"""Commands run as they do for people, on the emulated bus."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import pytest

from tests.robot.conftest import RunningEmulator, bus, emulator, start_emulator, write_log  # noqa: F401 - fixtures

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def armbridge(emulator: RunningEmulator) -> Run:  # noqa: F811 - the fixture
    """Runs a command on the emulated bus, with lines for its questions."""

    def run(command: str, *options: str, answers: str = "") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "server.cli", command, "--serial", emulator.port, *options],
            input=answers,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    return run
