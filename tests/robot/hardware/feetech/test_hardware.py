from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.calibration import RAD_PER_TICK
from robot.emulator.process import PseudoTerminal
from robot.errors import PortNotFound, StartupError
from robot.faults import FaultCode
from robot.hardware.config import FeetechConfig
from robot.hardware.feetech.hardware import (
    ASK_ALL_EVERY,
    ASK_SILENT_EVERY,
    FREE_SPEED_RAD_S,
    JUMP_RAD,
    MISSES_UNTIL_SILENT,
    FeetechHardware,
    SerialServos,
    ServoWatch,
)
from robot.hardware.feetech.packets import StatusFrame
from robot.hardware.feetech.registers import Register, encode
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.survey import CYCLES_BETWEEN
from robot.hardware.interface import Measured, StatusFlag, run_to_end
from robot.messages import GuardLimits, Mode, Order
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, NAMES, ArmRig
from tests.helpers.emulator import SteppedClock, SteppedEmulator
from tests.helpers.server import read_write_log

SERVOS = ServoMap(CALIBRATION, BOUNDS)


def frame(servo_id: int, ticks: int = 2048, error: int = 0) -> StatusFrame:
    data = encode(Register.PRESENT_POSITION, ticks).ljust(15, b"\0")
    return StatusFrame(servo_id, error, data)


def answered(watch: ServoWatch, *silent: int, now_s: float = 0.0) -> list[int]:
    """One cycle in which all but some servos answer; returns who was asked."""
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo) for servo in asked if servo not in silent}, now_s)
    return asked


def test_readings_are_complete_once_every_servo_has_answered() -> None:
    watch = ServoWatch(SERVOS)
    answered(watch, 3)
    assert not watch.complete
    answered(watch)
    assert watch.complete


def test_a_missed_reading_keeps_the_last_one_and_its_age() -> None:
    watch = ServoWatch(SERVOS)
    answered(watch, now_s=1.0)
    answered(watch, 3, now_s=1.01)
    ages = watch.measured(1.01, 0.0).age_s
    assert ages == pytest.approx([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])


def test_a_servo_that_stays_silent_is_asked_last_and_only_now_and_then() -> None:
    watch = ServoWatch(SERVOS)
    answered(watch)
    for _ in range(MISSES_UNTIL_SILENT):
        assert 3 in answered(watch, 3)
    rounds = [answered(watch, 3) for _ in range(10 * ASK_SILENT_EVERY)]
    with_it = [asked for asked in rounds if 3 in asked]
    assert len(with_it) == 10
    assert all(asked[-1] == 3 for asked in with_it)
    assert watch.silent_cycles[3] == MISSES_UNTIL_SILENT + len(rounds)


def test_where_none_speaks_all_are_asked_at_once_and_sequences_have_room_in_between() -> None:
    watch = ServoWatch(SERVOS)
    for _ in range(MISSES_UNTIL_SILENT):
        assert len(answered(watch, *SERVOS.ids)) == len(SERVOS.ids)
    asked = [len(answered(watch, *SERVOS.ids)) for _ in range(10 * ASK_ALL_EVERY)]
    assert sorted(asked) == [0] * 10 * (ASK_ALL_EVERY - 1) + [len(SERVOS.ids)] * 10


def test_a_servo_that_answers_again_is_asked_every_time() -> None:
    watch = ServoWatch(SERVOS)
    for _ in range(2 * ASK_SILENT_EVERY):
        answered(watch, 3)
    for _ in range(ASK_SILENT_EVERY):
        answered(watch)
    assert all(3 in answered(watch) for _ in range(ASK_SILENT_EVERY))


def test_positions_are_those_of_the_calibration() -> None:
    watch = ServoWatch(SERVOS)
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo, 1800 + servo) for servo in asked}, 0.0)
    expected = [joint.rad_from_ticks(1800 + joint.servo_id) for joint in CALIBRATION.joints]
    assert watch.measured(0.0, 0.0).position_rad == pytest.approx(expected)


def test_the_error_byte_of_the_reply_counts_as_status() -> None:
    watch = ServoWatch(SERVOS)
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo, error=int(StatusFlag.OVERLOAD)) for servo in asked}, 0.0)
    assert watch.measured(0.0, 0.0).status[0] == StatusFlag.OVERLOAD


def frames_with(servo: int, ticks: int) -> dict[int, StatusFrame]:
    """Replies of all servos, of which one stands elsewhere."""
    return {each: frame(each, ticks if each == servo else 2048) for each in SERVOS.ids}


def believed_ticks(watch: ServoWatch, servo: int, ticks: int, now_s: float) -> int:
    """One cycle in which one servo tells a position; returns the one that is kept."""
    watch.take(list(SERVOS.ids), frames_with(servo, ticks), now_s)
    return kept(watch, servo, now_s)


def kept(watch: ServoWatch, servo: int, now_s: float) -> int:
    """The position of a servo that is kept [ticks]."""
    joint = SERVOS.ids.index(servo)
    return CALIBRATION.joints[joint].ticks_from_rad(float(watch.measured(now_s, 0.0).position_rad[joint]))


FAR_TICKS = round(JUMP_RAD / RAD_PER_TICK) + 200


def test_a_jump_that_no_joint_can_make_is_not_believed_once() -> None:
    watch = ServoWatch(SERVOS)
    assert believed_ticks(watch, 5, 2048, 0.0) == 2048
    assert believed_ticks(watch, 5, 2048 + FAR_TICKS, 0.01) == 2048
    assert watch.age_s(5, 0.01) == pytest.approx(0.01)
    assert believed_ticks(watch, 5, 2050, 0.02) == 2050


def test_a_jump_in_two_readings_in_a_row_is_believed() -> None:
    watch = ServoWatch(SERVOS)
    believed_ticks(watch, 5, 2048, 0.0)
    believed_ticks(watch, 5, 2048 + FAR_TICKS, 0.01)
    assert believed_ticks(watch, 5, 2048 + FAR_TICKS, 0.02) == 2048 + FAR_TICKS


def test_a_jump_that_the_same_replies_repeat_is_believed() -> None:
    watch = ServoWatch(SERVOS)
    believed_ticks(watch, 5, 2048, 0.0)
    jumped = frames_with(5, 2048 + FAR_TICKS)
    watch.take(list(SERVOS.ids), jumped, 0.01)
    assert kept(watch, 5, 0.01) == 2048
    watch.take(list(SERVOS.ids), jumped, 0.02)
    assert kept(watch, 5, 0.02) == 2048 + FAR_TICKS


def test_the_same_replies_again_are_readings_as_fresh_as_others() -> None:
    watch = ServoWatch(SERVOS)
    replies = frames_with(5, 1900)
    for now_s in (1.0, 2.0):
        watch.take(list(SERVOS.ids), replies, now_s)
    measured = watch.measured(2.01, 7.0)
    assert measured.age_s == pytest.approx(np.full(6, 0.01))
    assert measured.stamp_s == 7.0
    assert kept(watch, 5, 2.01) == 1900


def test_a_reading_that_follows_the_same_one_again_takes_its_place() -> None:
    watch = ServoWatch(SERVOS)
    replies = frames_with(5, 1900)
    for now_s in (1.0, 1.01):
        watch.take(list(SERVOS.ids), replies, now_s)
        assert kept(watch, 5, now_s) == 1900
    assert believed_ticks(watch, 5, 1910, 1.02) == 1910


def test_jumps_with_a_good_reading_between_them_are_not_believed() -> None:
    watch = ServoWatch(SERVOS)
    for cycle in range(10):
        assert believed_ticks(watch, 5, 2048 + FAR_TICKS * (cycle % 2), 0.01 * cycle) == 2048


def test_a_joint_that_was_not_heard_for_long_may_have_turned_far() -> None:
    watch = ServoWatch(SERVOS)
    believed_ticks(watch, 5, 1000, 0.0)
    turned = round(FREE_SPEED_RAD_S * 0.5 / RAD_PER_TICK)
    assert believed_ticks(watch, 5, 1000 + turned, 0.5) == 1000 + turned


FULL = np.array([0.8] * 5 + [0.5])


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


class ServosInUse:
    """Hardware on emulated servos, found and read once."""

    def __init__(self, emulator: SteppedEmulator) -> None:
        self.emulator = emulator
        self.hardware = FeetechHardware(emulator.open_bus(), CALIBRATION, BOUNDS, GuardLimits(), emulator.clock)
        self.found = run_to_end(self.hardware.survey())
        self.read()

    def read(self, after_s: float = 0.01) -> Measured:
        self.emulator.run(after_s)
        measured = self.hardware.read()
        assert measured is not None
        return measured

    def enable(self) -> np.ndarray:
        """Bring all joints to hold; returns their goals."""
        return run_to_end(self.hardware.enable(range(6)), self.emulator.run)

    def registers(self, register: Register) -> list[int]:
        return [self.hardware.bus.read(joint.servo_id, register) for joint in CALIBRATION.joints]


@pytest.fixture
def servos(emulator: SteppedEmulator) -> ServosInUse:
    return ServosInUse(emulator)


def test_relaxed_servos_have_no_goals(servos: ServosInUse) -> None:
    assert not servos.found.driven.any()
    assert np.isnan(servos.found.goal_rad).all()
    assert servos.found.max_voltage_v == pytest.approx([8.0] * 6)


def test_servos_that_hold_are_found_with_their_goals(servos: ServosInUse) -> None:
    goal_rad = servos.enable()
    found = ServosInUse(servos.emulator).found
    assert found.driven.all()
    assert found.goal_rad == pytest.approx(goal_rad)


def test_the_soft_limits_are_narrowed_to_what_the_servos_allow(emulator: SteppedEmulator) -> None:
    emulator.open_bus().write(1, Register.MAX_ANGLE_LIMIT, CALIBRATION.joints[0].ticks_from_rad(0.5))
    found = ServosInUse(emulator).found
    assert found.bounds.upper_rad[0] == pytest.approx(0.5, abs=0.05)
    assert found.bounds.upper_rad[1:] == pytest.approx(BOUNDS.upper_rad[1:])


def test_goals_are_written_in_radians(servos: ServosInUse) -> None:
    servos.enable()
    servos.hardware.write_goals(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert servos.read(1.0).position_rad[0] == pytest.approx(0.1, abs=0.01)


def test_a_goal_that_a_servo_has_lost_is_written_again(servos: ServosInUse) -> None:
    servos.enable()
    goal_rad = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    servos.hardware.write_goals(goal_rad)
    written = servos.registers(Register.GOAL_POSITION)
    servos.hardware.bus.write(1, Register.GOAL_POSITION, 2000)
    servos.hardware.write_goals(goal_rad)
    assert servos.registers(Register.GOAL_POSITION) == written


def test_changed_goals_are_written_at_once(servos: ServosInUse) -> None:
    written = []
    for pan_rad in (0.1, 0.2):
        servos.hardware.write_goals(np.array([pan_rad, 0.0, 0.0, 0.0, 0.0, 0.0]))
        written.append(servos.registers(Register.GOAL_POSITION)[0])
    assert written == [CALIBRATION.joints[0].ticks_from_rad(pan_rad) for pan_rad in (0.1, 0.2)]


def test_an_unchanged_torque_limit_is_written_once(servos: ServosInUse) -> None:
    servos.enable()
    sent = servos.hardware.bus.counters.sent
    for _ in range(3):
        servos.hardware.write_torque_shares(FULL * [1, 1, 1, 1, 1, 0.5])
    assert servos.hardware.bus.counters.sent - sent == 1
    assert servos.registers(Register.TORQUE_LIMIT) == [800] * 5 + [250]


def test_changed_torque_limits_are_written_at_once(servos: ServosInUse) -> None:
    servos.enable()
    written = []
    for share in (0.5, 0.25):
        servos.hardware.write_torque_shares(FULL * [1, 1, 1, 1, 1, share])
        written.append(servos.registers(Register.TORQUE_LIMIT)[5])
    assert written == [250, 125]


def test_relaxing_begins_with_the_torque_that_is_used(servos: ServosInUse) -> None:
    servos.enable()
    steps = servos.hardware.relax(FULL * 0.5)
    next(steps)
    next(steps)
    assert max(servos.registers(Register.TORQUE_LIMIT)) <= 400
    assert run_to_end(steps, servos.emulator.run) == []
    assert servos.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_single_joints_are_switched_off(servos: ServosInUse) -> None:
    servos.enable()
    assert run_to_end(servos.hardware.switch_off([1, 5])) == []
    assert run_to_end(servos.hardware.driven()).tolist() == [True, False, True, True, True, False]


def test_a_servo_that_does_not_confirm_that_torque_is_off_is_named(servos: ServosInUse) -> None:
    servos.enable()
    servos.emulator.command(offline=[2])
    assert run_to_end(servos.hardware.cut_torque(), servos.emulator.run) == ["shoulder_lift (id 2)"]


def test_an_overload_is_cleared_where_the_joint_is_and_it_holds_on(servos: ServosInUse) -> None:
    goal_rad = servos.enable()
    servos.emulator.servo_bus.servos[3].protection._latched = StatusFlag.OVERLOAD
    assert servos.read(0.1).status[3] == StatusFlag.OVERLOAD
    held_rad = run_to_end(servos.hardware.clear_overloads([3], hold=True), servos.emulator.run)
    assert held_rad == pytest.approx(goal_rad, abs=0.03)
    assert servos.read(0.1).status[3] == 0
    assert servos.registers(Register.TORQUE_ENABLE) == [1] * 6


def test_an_overload_of_a_relaxed_arm_is_cleared_and_it_stays_relaxed(servos: ServosInUse) -> None:
    servos.emulator.servo_bus.servos[3].protection._latched = StatusFlag.OVERLOAD
    assert run_to_end(servos.hardware.clear_overloads([3], hold=False), servos.emulator.run) is None
    assert servos.read(0.1).status[3] == 0
    assert servos.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_every_servo_is_looked_at_in_its_turn(servos: ServosInUse) -> None:
    servos.enable()
    servos.emulator.command(power_cycle=[3])
    faults = [servos.hardware.check(5.0) for _ in range(6 * CYCLES_BETWEEN)]
    (fault,) = [fault for fault in faults if fault is not None]
    assert (fault.code, fault.joint, fault.stamp_s) == (FaultCode.SERVO_REBOOTED, "elbow_flex", 5.0)


def test_a_silent_servo_is_not_waited_for_by_the_check(servos: ServosInUse) -> None:
    servos.enable()
    servos.emulator.command(offline=[1, 2, 3, 4, 5, 6])
    for _ in range(30):
        servos.hardware.read()
    sent = servos.hardware.bus.counters.sent
    assert [servos.hardware.check(0.0) for _ in range(2 * CYCLES_BETWEEN)] == [None] * 2 * CYCLES_BETWEEN
    assert servos.hardware.bus.counters.sent == sent


def test_before_every_servo_was_heard_there_is_no_reading(emulator: SteppedEmulator) -> None:
    emulator.command(offline=[3])
    hardware = FeetechHardware(emulator.open_bus(), CALIBRATION, BOUNDS, GuardLimits(), emulator.clock)
    assert hardware.read() is None
    assert hardware.condition(0).age_s < 1.0
    assert math.isinf(hardware.condition(2).age_s)


def test_the_condition_has_torque_silence_and_the_surveys_warnings(emulator: SteppedEmulator) -> None:
    emulator.open_bus().write(2, Register.MIN_ANGLE_LIMIT, 1000)
    servos = ServosInUse(emulator)
    assert servos.hardware.condition(1).torque_enabled is None
    servos.enable()
    for _ in range(6 * CYCLES_BETWEEN):
        servos.hardware.check(0.0)
    emulator.command(offline=[2])
    servos.read()
    condition = servos.hardware.condition(1)
    assert (condition.hardware_id, condition.torque_enabled, condition.silent_cycles) == ("servo 2", True, 1)
    assert condition.age_s > 0.0
    assert len(condition.warnings) == 1
    assert "1000" in condition.warnings[0]


def test_round_trips_are_timed_on_the_loops_clock(servos: ServosInUse) -> None:
    assert 0.001 < servos.hardware.round_trips_s[-1] < 0.003


class Adapter:
    """The one USB adapter that is plugged in, wherever that is."""

    device = "/dev/does-not-exist"

    @classmethod
    def comports(cls) -> list[ListPortInfo]:
        info = ListPortInfo(cls.device)
        info.vid, info.pid = 0x1A86, 0x55D3
        return [info]


def test_an_adapter_is_looked_for_anew_each_time_that_it_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", Adapter.comports)
    source = SerialServos(FeetechConfig(CALIBRATION, "auto"), BOUNDS, GuardLimits(), SteppedClock())
    with pytest.raises(PortNotFound):
        source.open()
    with contextlib.closing(PseudoTerminal()) as terminal:
        monkeypatch.setattr(Adapter, "device", terminal.port)
        with contextlib.closing(source.open()) as hardware:
            assert hardware.joint_names == NAMES


def assumed(emulator: SteppedEmulator, *, simulated: bool) -> FeetechHardware:
    """Hardware whose calibration nobody has measured."""
    calibration = replace(CALIBRATION, measured=False)
    hardware = FeetechHardware(
        emulator.open_bus(), calibration, BOUNDS, GuardLimits(), emulator.clock, simulated=simulated
    )
    run_to_end(hardware.survey())
    return hardware


def test_a_real_arm_whose_zero_nobody_has_measured_is_not_enabled(emulator: SteppedEmulator) -> None:
    hardware = assumed(emulator, simulated=False)
    with pytest.raises(StartupError, match="no calibration says where the joints' zero is"):
        run_to_end(hardware.enable(range(6)), emulator.run)
    assert not run_to_end(hardware.driven(), emulator.run).any()


def test_an_emulated_arm_needs_no_calibration(emulator: SteppedEmulator) -> None:
    hardware = assumed(emulator, simulated=True)
    run_to_end(hardware.enable(range(6)), emulator.run)
    assert run_to_end(hardware.driven(), emulator.run).all()
