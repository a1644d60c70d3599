from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robot.messages import Mode, Order
from tests.helpers.arm_rig import ArmRig
from tests.helpers.server import read_write_log
from tests.helpers.stepped_emulator import SteppedEmulator


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "writes.jsonl"


@pytest.fixture
def rig(start_emulator: Callable[..., SteppedEmulator], log: Path) -> ArmRig:
    made = ArmRig(start_emulator("--write-log", str(log)), start_enabled=False)
    made.until_mode(Mode.RELAXED)
    return made


def test_a_relaxed_arm_is_read_and_nothing_is_written(rig: ArmRig, log: Path) -> None:
    before = rig.state.stamp_s
    rig.run(0.2)
    assert rig.state.stamp_s > before
    assert read_write_log(log) == []


def test_a_cycle_is_one_block_read_and_one_goal_write(rig: ArmRig) -> None:
    rig.order(Order.ENABLE)
    arm = rig.supervisor.arm
    assert arm is not None
    before = rig.bus.counters.sent
    for _ in range(16):
        arm.tick()
    # Every sixteenth cycle one servo is read back.
    assert rig.bus.counters.sent - before == 16 * 2 + 1
