from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest

from robot.errors import StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, goal_block
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.torque import (
    BROADCASTS,
    FIRST_TORQUE,
    OFF_INTERVAL_S,
    TORQUE_ON_WITHIN_TICKS,
    TickLimits,
    emergency_stop,
    enable,
    full_torque,
    relax,
    switch_off,
)
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, run
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.server import read_write_log

SERVOS = ServoMap(CALIBRATION, BOUNDS)
IDS = list(SERVOS.ids)
LIMITS = TickLimits(SERVOS.ticks_range(BOUNDS), {j.servo_id: (j.range_min, j.range_max) for j in CALIBRATION.joints})
POSE = "0.5,-0.5,0.5,0.2,0.1,0.3"

Start = Callable[..., SteppedEmulator]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "writes.jsonl"


@pytest.fixture
def logged_bus(start_emulator: Start, log: Path) -> contextlib.AbstractContextManager[Bus]:
    return contextlib.closing(start_emulator("--write-log", str(log), "--start", POSE).open_bus())


def switch_on(bus: Bus, limits: TickLimits = LIMITS) -> dict[int, int]:
    return run(enable(bus, SERVOS, limits, IDS))


def registers(bus: Bus, register: Register) -> list[int]:
    return [bus.read(servo, register) for servo in IDS]


def test_a_relaxed_arm_is_held_where_it_is(logged_bus: contextlib.AbstractContextManager[Bus]) -> None:
    with logged_bus as bus:
        goals = switch_on(bus)
        assert registers(bus, Register.TORQUE_ENABLE) == [1] * 6
        assert registers(bus, Register.GOAL_POSITION) == list(goals.values())
        present = registers(bus, Register.PRESENT_POSITION)
    assert all(abs(p - g) < TORQUE_ON_WITHIN_TICKS for p, g in zip(present, goals.values(), strict=True))


def test_torque_comes_on_at_the_goal_and_capped(logged_bus: contextlib.AbstractContextManager[Bus], log: Path) -> None:
    with logged_bus as bus:
        switch_on(bus)
    goals: dict[str, int] = {}
    limits: dict[str, int] = {}
    switched_on = set()
    for entry in read_write_log(log):
        for servo, data in entry["data"].items():
            if entry["address"] == GOAL_ADDRESS:
                goals[servo] = data[1] | data[2] << 8
            elif entry["address"] == Register.TORQUE_LIMIT:
                limits[servo] = data[0] | data[1] << 8
            elif entry["address"] == Register.TORQUE_ENABLE and data == [1]:
                switched_on.add(servo)
                assert abs(goals[servo] - entry["present"][servo]) <= TORQUE_ON_WITHIN_TICKS
                assert limits[servo] == FIRST_TORQUE
    assert switched_on == {str(servo) for servo in IDS}


def test_no_servo_is_given_more_than_its_limit_on_the_way(
    logged_bus: contextlib.AbstractContextManager[Bus], log: Path
) -> None:
    gentle = ServoMap(CALIBRATION, BOUNDS, GuardLimits(torque_limit=0.4, gripper_torque_limit=0.2))
    with logged_bus as bus:
        run(enable(bus, gentle, LIMITS, IDS))
        assert registers(bus, Register.TORQUE_LIMIT) == [400] * 5 + [200]
    written = [entry["data"] for entry in read_write_log(log) if entry["address"] == Register.TORQUE_LIMIT]
    assert max(data["6"][0] | data["6"][1] << 8 for data in written if "6" in data) == 200


def test_an_arm_that_holds_is_adopted_and_not_one_register_is_written(
    logged_bus: contextlib.AbstractContextManager[Bus], log: Path
) -> None:
    with logged_bus as bus:
        first = switch_on(bus)
        bus.ping(1)  # the emulator has then logged all that came before
        written = len(read_write_log(log))
        assert switch_on(bus) == first
        bus.ping(1)
        assert len(read_write_log(log)) == written


def test_a_half_switched_arm_is_completed(bus: Bus) -> None:
    switch_on(bus)
    bus.write(3, Register.TORQUE_ENABLE, 0)
    switch_on(bus)
    assert registers(bus, Register.TORQUE_ENABLE) == [1] * 6


def test_the_goal_of_a_servo_that_holds_is_not_touched_however_far_it_is(bus: Bus) -> None:
    switch_on(bus)
    present = bus.read(1, Register.PRESENT_POSITION)
    # At the slowest speed the servo stays far behind this goal for long.
    bus.sync_write(GOAL_ADDRESS, {1: goal_block(present + 800, 1, 254)})
    assert switch_on(bus)[1] == present + 800
    assert bus.read(1, Register.GOAL_POSITION) == present + 800


def test_an_arm_whose_relaxing_was_cut_short_gets_its_full_torque_back(bus: Bus) -> None:
    switch_on(bus)
    bus.write(2, Register.TORQUE_LIMIT, 100)
    switch_on(bus)
    assert bus.read(2, Register.TORQUE_LIMIT) == 800


def test_an_arm_outside_its_limits_is_not_switched_on(start_emulator: Start) -> None:
    with contextlib.closing(start_emulator("--start", "1.5,0,0,0,0,0").open_bus()) as bus:
        narrow = TickLimits({**LIMITS.soft, 1: (1500, 2500)}, LIMITS.servo)
        with pytest.raises(StartupError, match="shoulder_pan stands at"):
            switch_on(bus, narrow)
        assert registers(bus, Register.TORQUE_ENABLE) == [0] * 6


def test_a_servo_that_would_clamp_its_goal_is_not_switched_on(start_emulator: Start) -> None:
    with contextlib.closing(start_emulator("--start", "1.5,0,0,0,0,0").open_bus()) as bus:
        narrow = TickLimits(LIMITS.soft, {**LIMITS.servo, 1: (1500, 2500)})
        with pytest.raises(StartupError, match="shoulder_pan stands at"):
            switch_on(bus, narrow)


def test_what_was_switched_on_is_switched_off_when_a_servo_fails(emulator: SteppedEmulator, bus: Bus) -> None:
    steps = enable(bus, SERVOS, LIMITS, IDS)
    while bus.read(2, Register.TORQUE_ENABLE) == 0:
        next(steps)
    emulator.command(offline=[4])
    with pytest.raises(StartupError, match="could not be verified at wrist_flex"):
        run(steps)
    assert bus.read(1, Register.TORQUE_ENABLE) == 0


def test_relaxing_lowers_torque_step_by_step_and_then_takes_it_off(
    logged_bus: contextlib.AbstractContextManager[Bus], log: Path
) -> None:
    with logged_bus as bus:
        switch_on(bus)
        bus.ping(1)
        before = len(read_write_log(log))
        assert run(relax(bus, SERVOS, full_torque(SERVOS))) == []
        assert registers(bus, Register.TORQUE_ENABLE) == [0] * 6
    entries = read_write_log(log)[before:]
    off = next(i for i, entry in enumerate(entries) if entry["address"] == Register.TORQUE_ENABLE)
    limits = [e["data"]["1"][0] | e["data"]["1"][1] << 8 for e in entries[:off]]
    assert limits == sorted(limits, reverse=True)
    assert limits[-1] == 0


def test_an_emergency_stop_is_broadcast_three_times_and_verified(
    logged_bus: contextlib.AbstractContextManager[Bus], log: Path
) -> None:
    with logged_bus as bus:
        switch_on(bus)
        bus.ping(1)
        before = len(read_write_log(log))
        assert run(emergency_stop(bus, SERVOS)) == []
        assert registers(bus, Register.TORQUE_ENABLE) == [0] * 6
    assert len(read_write_log(log)) - before == BROADCASTS


def test_servos_whose_torque_cannot_be_verified_are_named(emulator: SteppedEmulator, bus: Bus) -> None:
    switch_on(bus)
    emulator.command(offline=[3, 5])
    assert run(emergency_stop(bus, SERVOS)) == [3, 5]
    assert run(switch_off(bus, [3])) == [3]


def test_a_servo_that_is_deaf_for_a_moment_is_switched_off_all_the_same(emulator: SteppedEmulator, bus: Bus) -> None:
    switch_on(bus)
    emulator.command(offline=[3])
    steps = switch_off(bus, IDS)
    while next(steps) != OFF_INTERVAL_S:
        pass
    emulator.command(online=[3])
    assert run(steps) == []
    assert registers(bus, Register.TORQUE_ENABLE) == [0] * 6


def test_lost_replies_do_not_hinder_the_start(start_emulator: Start) -> None:
    with contextlib.closing(start_emulator("--drop", "0.02", "--corrupt", "0.02", "--seed", "3").open_bus()) as bus:
        switch_on(bus)
        assert bus.counters.timeouts > 0
        assert registers(bus, Register.TORQUE_ENABLE) == [1] * 6
