"""lerobot's own driver sets up, connects to and reads the emulated servos of a kit.

lerobot needs torch, and an environment of its own: ``make test-lerobot`` makes it and runs this.
"""

import json
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from harness.emulator import RunningEmulator
from harness.waiting import running
from tests.helpers.kit import KIT
from tests.helpers.robots import SO101_SERVOS

SCENARIO = Path(__file__).with_name("motors_scenario.py")
PYTHON = Path(__file__).parents[2] / "build" / "lerobot" / "bin" / "python"
JOINTS = [servo.joint for servo in SO101_SERVOS]

pytestmark = pytest.mark.skipif(not PYTHON.exists(), reason="lerobot is not installed: make test-lerobot does it")


@contextmanager
def driver(port: str) -> Iterator[Callable[[str], object]]:
    """Start lerobot's driver; the yielded function carries out a step of the scenario and returns its result."""
    with running([PYTHON, SCENARIO, port, *JOINTS], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def step(text: str) -> object:
            print(text, file=process.stdin, flush=True)
            return json.loads(process.stdout.readline())

        yield step
        process.stdin.close()


def test_a_kit_is_set_up_and_read_by_lerobot(start_terminal: Callable[..., RunningEmulator], tmp_path: Path) -> None:
    emulator = start_terminal(*KIT, "--link", str(tmp_path / "port"))
    with driver(str(tmp_path / "port")) as step:
        for joint in reversed(JOINTS):
            emulator.command(unplug=[each for each in JOINTS if each != joint], plug=[joint])
            assert step(f"setup {joint}") is None
        emulator.command(plug=JOINTS)
        positions_deg = step("positions")
    assert isinstance(positions_deg, dict)
    assert sorted(positions_deg) == sorted(JOINTS)
    assert all(-180.0 <= each <= 180.0 for each in positions_deg.values())
