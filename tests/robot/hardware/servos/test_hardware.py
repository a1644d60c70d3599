import contextlib
import math
import struct
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.calibration import RAD_PER_TICK, TICKS_PER_TURN
from robot.description.limits import FASTEST_TICKS_S
from robot.emulator.process import UsbAdapter
from robot.errors import PortError, StartupError
from robot.hardware.config import SerialConfig
from robot.hardware.dynamixel.family import ALERT
from robot.hardware.dynamixel.registers import MOTION
from robot.hardware.interface import StatusFlag, run_to_end
from robot.hardware.servos.bus import StatusFrame
from robot.hardware.servos.family import ServoFamily, ServoMap
from robot.hardware.servos.hardware import (
    ASK_ALL_EVERY,
    ASK_SILENT_EVERY,
    CYCLES_BETWEEN,
    EMPTY_READS_PER_SERVO,
    MISSES_UNTIL_LAST,
    MISSES_UNTIL_SILENT,
    ServoHardware,
    ServoTracker,
    open_servos,
)
from robot.messages import GuardLimits
from tests.helpers.servo_families import DYNAMIXEL, IDS, Family


@pytest.fixture
def servos(family: Family) -> Any:
    return family.in_use()


FULL = np.array([0.8] * 5 + [0.5])
PAN_A_LITTLE = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_a_lost_goal_is_written_again_a_changed_torque_limit_once_and_relaxing_begins_there(
    family: Family, servos: Any
) -> None:
    servos.enable()
    servos.hardware.write_goals(PAN_A_LITTLE)
    written = family.values(servos.emulator, "GOAL_POSITION")
    family.put(servos.emulator, 1, "GOAL_POSITION", 2000)
    servos.hardware.write_goals(PAN_A_LITTLE)
    assert family.values(servos.emulator, "GOAL_POSITION") == written
    for share in (0.5, 0.25):
        sent = servos.hardware.bus.counters.sent
        for _ in range(3):
            servos.hardware.write_torque_shares(FULL * [1, 1, 1, 1, 1, share])
        assert servos.hardware.bus.counters.sent - sent == 1
        assert family.limits(servos.emulator) == pytest.approx([0.8] * 5 + [0.5 * share], abs=0.001)
    steps = servos.hardware.relax(FULL * 0.5)
    next(steps)
    next(steps)
    assert max(family.limits(servos.emulator)) <= 0.4 + 0.001
    assert run_to_end(steps, servos.emulator.run) == []
    assert family.values(servos.emulator, "TORQUE_ENABLE") == [0] * 6


@pytest.mark.parametrize("hold", [True, False])
def test_an_overload_is_cleared_where_the_joint_holds_or_is_relaxed(family: Family, servos: Any, hold: bool) -> None:
    goal_rad = servos.enable() if hold else None
    family.fail(servos.emulator.servo_bus.servos[3])
    assert servos.read(0.1).status[3] == StatusFlag.OVERLOAD
    held_rad = run_to_end(servos.hardware.clear_overloads([3], hold=hold), servos.emulator.run)
    assert held_rad is None if goal_rad is None else held_rad == pytest.approx(goal_rad, abs=0.03)
    assert servos.read(0.1).status[3] == 0
    assert family.values(servos.emulator, "TORQUE_ENABLE") == [int(hold)] * 6


def test_a_silent_servo_is_not_waited_for_by_the_check(family: Family, servos: Any) -> None:
    servos.enable()
    servos.emulator.servo_bus.faults.offline = set(IDS)
    for _ in range(6 * MISSES_UNTIL_SILENT):
        servos.hardware.read()
    sent = servos.hardware.bus.counters.sent
    assert [servos.hardware.check(0.0) for _ in range(40)] == [None] * 40
    assert servos.hardware.bus.counters.sent == sent


def test_the_condition_has_torque_silence_and_the_surveys_warnings(family: Family) -> None:
    emulator = family.emulator()
    family.put(emulator, 2, family.lowest_limit, 1000)
    servos = family.in_use(emulator)
    assert servos.hardware.health(1).torque_enabled is None
    servos.enable()
    for _ in range(6 * len(family.driver.read_back) * CYCLES_BETWEEN):
        servos.hardware.check(0.0)
    emulator.servo_bus.faults.offline = {2}
    servos.read()
    condition = servos.hardware.health(1)
    assert (condition.hardware_id, condition.torque_enabled, condition.silent_cycles) == ("servo 2", True, 1)
    assert condition.age_s > 0.0
    (warning,) = condition.warnings
    joint = family.calibration.joints[1]
    assert f"(1000, {joint.range_max})" in warning.sentence
    assert f"({joint.range_min}, {joint.range_max})" in warning.sentence


def writes(emulator: Any) -> list[Any]:
    """Keep the writes that the servos get from now on, which do not take them."""
    written: list[Any] = []
    for servo in emulator.servo_bus.servos:
        servo.write = lambda *arguments: written.append(arguments)
    return written


def test_a_relaxed_arm_is_found_and_read_and_nothing_is_written(family: Family) -> None:
    emulator = family.emulator()
    written = writes(emulator)
    assert not family.in_use(emulator).found.driven.any()
    rig = family.rig(emulator, start_enabled=False).started()
    before = rig.state.stamp_s
    rig.run(0.2)
    assert rig.state.stamp_s > before
    assert written == []


def test_a_cycle_is_one_block_read_and_one_goal_write_and_now_and_then_a_register_is_read_back(family: Family) -> None:
    arm = family.rig(family.emulator()).started().supervisor.arm
    before = arm.hardware.counters.sent
    for _ in range(CYCLES_BETWEEN):
        arm.tick()
    assert arm.hardware.counters.sent - before == CYCLES_BETWEEN * 2 + 1


def surveyed(family: Family, emulator: Any, *, simulated: bool = False, **calibration: bool) -> Any:
    """Hardware with another kind of calibration."""
    settings = replace(family.calibration, **calibration), family.bounds, GuardLimits(), emulator.clock
    hardware = ServoHardware(family.driver, emulator.open_bus(), *settings, simulated=simulated)
    run_to_end(hardware.survey())
    return hardware


def test_a_real_arm_with_an_unmeasured_or_another_calibration_is_read_but_not_enabled(family: Family) -> None:
    for changed_ticks, calibration, words in (
        (0, {"measured": False}, r"no calibration says where the joints' zero is.*--calibration"),
        (10, {"offsets_known": True}, "the zero has shifted since the calibration at elbow_flex"),
    ):
        emulator = family.emulator()
        family.put(emulator, 3, "HOMING_OFFSET", family.calibration.joints[2].homing_offset + changed_ticks)
        hardware = surveyed(family, emulator, **calibration)
        written = writes(emulator)
        with pytest.raises(StartupError, match=words):
            run_to_end(hardware.enable(range(6)), emulator.run)
        assert written == []
        assert hardware.read().position_rad.shape == (6,)
    # An emulated arm needs none.
    emulator = family.emulator()
    hardware = surveyed(family, emulator, simulated=True, measured=False)
    run_to_end(hardware.enable(range(6)), emulator.run)
    assert run_to_end(hardware.driven(), emulator.run).all()


def test_an_adapter_is_looked_for_each_time_that_it_is_opened(monkeypatch: pytest.MonkeyPatch, family: Family) -> None:
    plugged_in = ListPortInfo("/dev/does-not-exist")
    plugged_in.vid, plugged_in.pid = 0x1A86, 0x55D3
    monkeypatch.setattr(list_ports, "comports", lambda: [plugged_in])
    config = SerialConfig(family.calibration, "auto", baud=57_600)
    opener = partial(open_servos, family.driver, config, family.bounds, GuardLimits(), lambda: 0.0)
    with pytest.raises(PortError):
        opener()
    terminal = UsbAdapter()
    plugged_in.device = terminal.port
    with contextlib.closing(opener()) as hardware:
        assert hardware.joint_names == tuple(joint.joint for joint in family.calibration.joints)
        assert hardware.bus._port.baudrate == 57_600
    terminal.unplug()


@pytest.fixture
def tracker(family: Family) -> ServoTracker:
    return ServoTracker(family.driver, family.servo_map)


def answered(family: Family, tracker: ServoTracker, *silent: int, now_s: float = 0.0) -> list[int]:
    """One cycle in which all but some servos answer; returns who was asked."""
    asked: list[int] = tracker.ids_to_ask()
    tracker.take(asked, {servo: family.frame(servo, 2048) for servo in asked if servo not in silent}, now_s)
    return asked


def test_readings_are_complete_once_all_have_answered_and_all_asked_at_once_where_none_does(
    family: Family, tracker: ServoTracker
) -> None:
    assert tracker.age_s(3, 1.0) == math.inf
    answered(family, tracker, 3)
    assert not tracker.complete
    answered(family, tracker)
    assert tracker.complete
    for _ in range(EMPTY_READS_PER_SERVO * len(IDS)):
        assert len(answered(family, tracker, *IDS)) == len(IDS)
    asked = [len(answered(family, tracker, *IDS)) for _ in range(10 * ASK_ALL_EVERY)]
    assert sorted(asked) == [0] * 10 * (ASK_ALL_EVERY - 1) + [len(IDS)] * 10


def test_a_servo_that_misses_its_turn_is_asked_last_and_seldom(family: Family, tracker: ServoTracker) -> None:
    answered(family, tracker)
    for _ in range(MISSES_UNTIL_LAST):
        answered(family, tracker, 2)
    assert answered(family, tracker, 2) == [1, 3, 4, 5, 6, 2]
    answered(family, tracker)
    assert answered(family, tracker) == [1, 2, 3, 4, 5, 6]
    for _ in range(MISSES_UNTIL_SILENT):
        assert 3 in answered(family, tracker, 3)
    rounds = [answered(family, tracker, 3) for _ in range(10 * ASK_SILENT_EVERY)]
    with_it = [asked for asked in rounds if 3 in asked]
    assert len(with_it) == 10
    assert all(asked[-1] == 3 for asked in with_it)
    assert tracker.silent_cycles[3] == MISSES_UNTIL_SILENT + len(rounds)
    while 3 in tracker.ids_to_ask():
        answered(family, tracker, 3)
    assert tracker.is_silent(3)
    tracker.ask_again(3)
    assert 3 in tracker.ids_to_ask()


FAR_TICKS = round(ServoFamily.jump_rad / RAD_PER_TICK) + 200


def replies(family: Family, ticks: int) -> dict[int, Any]:
    """Replies of all servos, of which the fifth stands somewhere else."""
    return {servo: family.frame(servo, ticks if servo == 5 else 2048) for servo in IDS}


def kept(family: Family, tracker: ServoTracker, told: dict[int, Any], now_s: float) -> int:
    """One cycle with some replies; returns the position of the fifth servo that is kept [ticks]."""
    tracker.take(list(IDS), told, now_s)
    return family.calibration.joints[4].ticks_from_rad(float(tracker.measured(now_s, 0.0).position_rad[4]))


@pytest.mark.parametrize("repeated", [False, True])
def test_an_impossible_jump_is_believed_when_it_repeats(family: Family, tracker: ServoTracker, repeated: bool) -> None:
    assert kept(family, tracker, replies(family, 2048), 0.0) == 2048
    for cycle in range(1, 10):
        at_s, jumped = 0.01 * cycle, replies(family, 2048 + FAR_TICKS * (cycle % 2))
        assert kept(family, tracker, jumped, at_s) == 2048
        assert tracker.age_s(5, at_s) == pytest.approx(0.01 * (cycle % 2))
    again = jumped if repeated else replies(family, 2048 + FAR_TICKS)
    assert kept(family, tracker, again, 0.1) == 2048 + FAR_TICKS
    # A joint that was not heard for long may have turned far.
    turned = 2048 + FAR_TICKS - round(5.5 * 0.5 / RAD_PER_TICK)
    assert kept(family, tracker, replies(family, turned), 0.6) == turned


def test_the_same_replies_again_are_readings_as_fresh_as_others(family: Family, tracker: ServoTracker) -> None:
    told = replies(family, 1900)
    for now_s in (1.0, 2.0):
        assert kept(family, tracker, told, now_s) == 1900
    measured = tracker.measured(2.01, 7.0)
    assert measured.age_s == pytest.approx(np.full(6, 0.01))
    assert measured.stamp_s == 7.0
    assert kept(family, tracker, replies(family, 1910), 2.02) == 1910


@pytest.mark.parametrize("blinded", [False, True])
def test_a_silent_servo_hardly_silences_the_others(family: Family, tracker: ServoTracker, blinded: bool) -> None:
    answered(family, tracker)
    for cycle in range(1, 4 * ASK_SILENT_EVERY):
        asked = tracker.ids_to_ask()
        behind = asked[asked.index(2) :] if blinded and 2 in asked else [2]
        told = {servo: family.frame(servo, 2048) for servo in asked if servo not in behind}
        tracker.take(asked, told, 0.01 * cycle)
        assert np.delete(tracker.measured(0.01 * cycle, 0.0).age_s, 1).max() <= 0.01 * MISSES_UNTIL_LAST + 1e-9
    assert tracker.is_silent(2)
    assert not any(tracker.is_silent(servo) for servo in IDS if servo != 2)


def dynamixel_replies(ticks: int = 2048, *, alerting: int = 0, whole: bool = True) -> dict[int, StatusFrame]:
    """Replies of all servos, of which one may report an error."""
    data = struct.pack("<hhiiiiHB", -443, 350, 10, ticks, 0, 0, 118, 41)
    return {
        servo: StatusFrame(servo, ALERT if servo == alerting else 0, data if whole else data[: MOTION.length])
        for servo in IDS
    }


@pytest.fixture
def dynamixels() -> ServoTracker:
    return ServoTracker(DYNAMIXEL.driver, DYNAMIXEL.servo_map)


def test_readings_are_complete_with_supply_and_temperature_in_the_controllers_units(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(whole=False), 0.0)
    assert not dynamixels.complete
    dynamixels.take(IDS, dynamixel_replies(), 0.0)
    assert dynamixels.complete
    measured = dynamixels.measured(0.25, 7.0)
    ticks_rad = [joint.rad_from_ticks(2048) for joint in DYNAMIXEL.calibration.joints]
    assert measured.position_rad == pytest.approx(ticks_rad)
    assert measured.velocity_rad_s[:5] == pytest.approx([2.29 * 2 * np.pi / 60] * 5)
    assert measured.load == pytest.approx([-443 / 885] * 6)
    assert measured.current_a == pytest.approx([math.nan] * 2 + [0.35] * 4, nan_ok=True)
    assert measured.voltage_v == pytest.approx([11.8] * 6)
    assert measured.temperature_c == pytest.approx([41.0] * 6)
    assert measured.age_s == pytest.approx([0.25] * 6)
    assert measured.stamp_s == 7.0


def test_an_alert_is_asked_about_until_it_is_known_and_again_later_until_it_is_over(dynamixels: ServoTracker) -> None:
    dynamixels.take(IDS, dynamixel_replies(), 0.0)
    assert dynamixels.alerting() == []
    dynamixels.take(IDS, dynamixel_replies(alerting=3), 0.01)
    assert dynamixels.alerting() == [3]
    dynamixels.take_error(3, int(StatusFlag.OVERLOAD))
    assert dynamixels.alerting() == []
    assert dynamixels.measured(0.01, 0.0).status.tolist() == [0, 0, int(StatusFlag.OVERLOAD), 0, 0, 0]
    dynamixels.take(IDS, dynamixel_replies(alerting=3), 0.1)
    assert dynamixels.alerting() == [3]
    assert dynamixels.measured(0.1, 0.0).status[2] == StatusFlag.OVERLOAD
    dynamixels.take(IDS, dynamixel_replies(), 0.11)
    assert not dynamixels.measured(0.11, 0.0).status.any()


DYNAMIXELS = DYNAMIXEL.servo_map


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(goal_rad=st.lists(st.floats(min_value=-1.6, max_value=1.6), min_size=6, max_size=6))
def test_goals_are_written_as_the_calibration_turns_them_into_ticks(family: Family, goal_rad: list[float]) -> None:
    servos = family.servo_map
    blocks = servos.goal_blocks(np.array(goal_rad), {servos.ids[0]: TICKS_PER_TURN})
    for joint, goal in zip(family.calibration.joints, goal_rad, strict=True):
        ticks = joint.ticks_from_rad(goal) - (TICKS_PER_TURN if joint.servo_id == servos.ids[0] else 0)
        # A goal halfway between two ticks may be rounded to either.
        assert blocks[joint.servo_id] in [servos.goal_block(joint.servo_id, ticks + off) for off in (-1, 0, 1)]


def test_velocities_have_the_joints_signs_and_a_servo_may_be_faster_but_not_by_much(
    family: Family,
) -> None:
    for joint, speed in zip(family.calibration.joints, family.bounds.max_velocity, strict=True):
        needed_ticks_s = abs(joint.ticks_s_from_rad_s(float(speed)))
        cap_ticks_s = family.servo_map.speed_ticks_s[joint.servo_id]
        assert needed_ticks_s < cap_ticks_s < 1.4 * needed_ticks_s or cap_ticks_s == FASTEST_TICKS_S
    fast = ServoMap(family.driver, family.calibration, replace(family.bounds, max_velocity=np.full(6, 100.0)))
    assert set(fast.speed_ticks_s.values()) == {FASTEST_TICKS_S}
    servos = family.servo_map
    faster = np.subtract(servos.positions_rad([2100] * 6), servos.positions_rad([2000] * 6))
    assert servos.velocities_rad_s([100] * 6) == pytest.approx(faster)
    *others, gripper = family.calibration.joints
    joints = (*others, replace(gripper, drive_mode=1))
    mirrored = ServoMap(family.driver, replace(family.calibration, joints=joints), family.bounds)
    assert mirrored.velocities_rad_s([10] * 6)[5] < 0.0
    assert mirrored.signed([0.5] * 6) == pytest.approx([0.5] * 5 + [-0.5])


@given(st.sampled_from(DYNAMIXELS.ids), st.integers(-5, 5), st.data())
def test_turns_that_a_servo_counts_do_not_change_its_position_in_the_range_that_is_certain(
    servo: int, turns: int, data: st.DataObject
) -> None:
    lowest, highest = DYNAMIXELS.certain_ticks(servo)
    ticks, joint = data.draw(st.integers(lowest, highest)), DYNAMIXELS.by_id[servo]
    assert DYNAMIXELS.turns_ticks(servo, ticks + turns * TICKS_PER_TURN) == -turns * TICKS_PER_TURN
    assert (highest - lowest) * RAD_PER_TICK > 0.9 * 2.0 * np.pi
    assert joint.range_max - joint.range_min > 4000 or (lowest < joint.range_min and joint.range_max < highest)
