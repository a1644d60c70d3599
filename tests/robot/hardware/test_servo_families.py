"""What servos of every family do alike: how their replies are taken, and what their hardware does with them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from robot.calibration import RAD_PER_TICK, Calibration
from robot.errors import NoReply, PortLost, StartupError
from robot.hardware.dynamixel import readings as dynamixel_readings
from robot.hardware.dynamixel import registers as dynamixel_registers
from robot.hardware.dynamixel import servo_map as dynamixel_map
from robot.hardware.dynamixel.packets import StatusFrame as DynamixelFrame
from robot.hardware.feetech import hardware as feetech_hardware
from robot.hardware.feetech import registers as feetech_registers
from robot.hardware.feetech import servo_map as feetech_map
from robot.hardware.feetech.packets import StatusFrame as FeetechFrame
from robot.hardware.interface import FREE_SPEED_RAD_S, JUMP_RAD, StatusFlag, run_to_end
from robot.messages import GuardLimits, Mode
from tests.helpers import arm_rig, dynamixel
from tests.helpers.arm_rig import ArmRig
from tests.helpers.dynamixel import DynamixelRig, DynamixelsInUse, SteppedDynamixels
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.feetech import FeetechsInUse, unread_hardware

IDS = (1, 2, 3, 4, 5, 6)


def unread_dynamixels(emulator: SteppedDynamixels) -> Any:
    bus, bounds = emulator.open_bus(), dynamixel.BOUNDS
    return dynamixel.DynamixelHardware(bus, dynamixel.METAL, bounds, GuardLimits(), emulator.clock)


@dataclass(frozen=True)
class Family:
    """What differs between the families.

    Attributes:
        servo_map: servos of the arm.
        calibration: of the arm.
        readings: module with the watch of the servos, and its limits.
        registers: module with ``Register`` and ``encode``.
        frame: reply of a servo that stands somewhere.
        empty_reads: reads without any reply until the bus counts as silent.
        emulator: kind of the emulated servos.
        in_use: kind of the hardware that was found and read once.
        unread: makes hardware that was not read.
        rig: kind of a supervisor on the emulated servos.
        checks_each: registers of a servo that are checked.
        fail: makes a servo report an overload.
        max_voltage_v: highest supply of each servo.
        limit: torque limit of a servo [share].
        lowest_limit: register and value of an angle limit that differs from the calibration.
    """

    servo_map: Any
    calibration: Calibration
    readings: Any
    registers: Any
    frame: Callable[[int, int], Any]
    empty_reads: int
    emulator: Any
    in_use: Any
    unread: Any
    rig: Any
    checks_each: int
    fail: Callable[[Any], object]
    max_voltage_v: list[float]
    limit: Callable[[Any], float]
    lowest_limit: str


FEETECH = Family(
    servo_map=feetech_map.ServoMap(arm_rig.CALIBRATION, arm_rig.BOUNDS),
    calibration=arm_rig.CALIBRATION,
    readings=feetech_hardware,
    registers=feetech_registers,
    frame=lambda servo, ticks: FeetechFrame(
        servo, 0, feetech_registers.encode(feetech_registers.Register.PRESENT_POSITION, ticks).ljust(15, b"\0")
    ),
    empty_reads=feetech_hardware.MISSES_UNTIL_SILENT,
    emulator=SteppedEmulator,
    in_use=FeetechsInUse,
    unread=unread_hardware,
    rig=ArmRig,
    checks_each=1,
    fail=lambda servo: setattr(servo.protection, "_latched", StatusFlag.OVERLOAD),
    max_voltage_v=[8.0] * 6,
    limit=lambda servo: servo.value(feetech_registers.Register.TORQUE_LIMIT) / 1000.0,
    lowest_limit="MIN_ANGLE_LIMIT",
)
DYNAMIXEL = Family(
    servo_map=dynamixel_map.ServoMap(dynamixel.CALIBRATION, dynamixel.BOUNDS),
    calibration=dynamixel.CALIBRATION,
    readings=dynamixel_readings,
    registers=dynamixel_registers,
    frame=lambda servo, ticks: DynamixelFrame(servo, 0, struct.pack("<hhiiiiHB", -443, 350, 10, ticks, 0, 0, 118, 41)),
    empty_reads=dynamixel_readings.EMPTY_READS_PER_SERVO * len(IDS),
    emulator=SteppedDynamixels,
    in_use=DynamixelsInUse,
    unread=unread_dynamixels,
    rig=DynamixelRig,
    checks_each=2,
    fail=lambda servo: servo.fail(0x20),
    max_voltage_v=[14.0] * 2 + [7.0] * 4,
    limit=lambda servo: servo._drive.torque_permille / 1000.0,
    lowest_limit="MIN_POSITION_LIMIT",
)


@pytest.fixture(params=[FEETECH, DYNAMIXEL], ids=["Feetech", "Dynamixel"])
def family(request: pytest.FixtureRequest) -> Family:
    return request.param


# Replies.


@pytest.fixture
def watch(family: Family) -> Any:
    return family.readings.ServoWatch(family.servo_map)


def answered(family: Family, watch: Any, *silent: int, now_s: float = 0.0) -> list[int]:
    """One cycle in which all but some servos answer; returns who was asked."""
    asked: list[int] = watch.ids_to_ask()
    watch.take(asked, {servo: family.frame(servo, 2048) for servo in asked if servo not in silent}, now_s)
    return asked


def test_readings_are_complete_once_every_servo_has_answered(family: Family, watch: Any) -> None:
    assert watch.age_s(3, 1.0) == math.inf
    answered(family, watch, 3)
    assert not watch.complete
    answered(family, watch)
    assert watch.complete


def test_a_missed_reading_keeps_the_last_one_and_its_age(family: Family, watch: Any) -> None:
    answered(family, watch, now_s=1.0)
    answered(family, watch, 3, now_s=1.01)
    assert watch.measured(1.01, 0.0).age_s == pytest.approx([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    assert watch.silent_cycles[3] == 1


def test_a_servo_that_stays_silent_is_asked_last_and_only_now_and_then(family: Family, watch: Any) -> None:
    answered(family, watch)
    for _ in range(family.readings.MISSES_UNTIL_SILENT):
        assert 3 in answered(family, watch, 3)
    rounds = [answered(family, watch, 3) for _ in range(10 * family.readings.ASK_SILENT_EVERY)]
    with_it = [asked for asked in rounds if 3 in asked]
    assert len(with_it) == 10
    assert all(asked[-1] == 3 for asked in with_it)
    assert watch.silent_cycles[3] == family.readings.MISSES_UNTIL_SILENT + len(rounds)


def test_where_none_speaks_all_are_asked_at_once_and_sequences_have_room_in_between(family: Family, watch: Any) -> None:
    for _ in range(family.empty_reads):
        assert len(answered(family, watch, *IDS)) == len(IDS)
    every = family.readings.ASK_ALL_EVERY
    asked = [len(answered(family, watch, *IDS)) for _ in range(10 * every)]
    assert sorted(asked) == [0] * 10 * (every - 1) + [len(IDS)] * 10


def test_a_servo_that_answers_again_is_asked_every_time(family: Family, watch: Any) -> None:
    for _ in range(2 * family.readings.ASK_SILENT_EVERY):
        answered(family, watch, 3)
    for _ in range(family.readings.ASK_SILENT_EVERY):
        answered(family, watch)
    assert all(3 in answered(family, watch) for _ in range(family.readings.ASK_SILENT_EVERY))


FAR_TICKS = round(JUMP_RAD / RAD_PER_TICK) + 200


def replies(family: Family, ticks: int) -> dict[int, Any]:
    """Replies of all servos, of which the fifth stands somewhere else."""
    return {servo: family.frame(servo, ticks if servo == 5 else 2048) for servo in IDS}


def kept(family: Family, watch: Any, told: dict[int, Any], now_s: float) -> int:
    """One cycle with some replies; returns the position of the fifth servo that is kept [ticks]."""
    watch.take(list(IDS), told, now_s)
    return family.calibration.joints[4].ticks_from_rad(float(watch.measured(now_s, 0.0).position_rad[4]))


def test_a_jump_that_no_joint_can_make_is_not_believed_once(family: Family, watch: Any) -> None:
    assert kept(family, watch, replies(family, 2048), 0.0) == 2048
    for cycle in range(1, 10):
        at_s, ticks = 0.01 * cycle, 2048 + FAR_TICKS * (cycle % 2)
        assert kept(family, watch, replies(family, ticks), at_s) == 2048
        assert watch.age_s(5, at_s) == pytest.approx(0.01 * (cycle % 2))


@pytest.mark.parametrize("repeated", [False, True], ids=["equal replies", "the same replies"])
def test_a_jump_in_two_readings_in_a_row_is_believed(family: Family, watch: Any, repeated: bool) -> None:
    kept(family, watch, replies(family, 2048), 0.0)
    jumped = replies(family, 2048 + FAR_TICKS)
    assert kept(family, watch, jumped, 0.01) == 2048
    again = jumped if repeated else replies(family, 2048 + FAR_TICKS)
    assert kept(family, watch, again, 0.02) == 2048 + FAR_TICKS


def test_the_same_replies_again_are_readings_as_fresh_as_others(family: Family, watch: Any) -> None:
    told = replies(family, 1900)
    for now_s in (1.0, 2.0):
        assert kept(family, watch, told, now_s) == 1900
    measured = watch.measured(2.01, 7.0)
    assert measured.age_s == pytest.approx(np.full(6, 0.01))
    assert measured.stamp_s == 7.0
    assert kept(family, watch, replies(family, 1910), 2.02) == 1910


def test_a_joint_that_was_not_heard_for_long_may_have_turned_far(family: Family, watch: Any) -> None:
    kept(family, watch, replies(family, 1000), 0.0)
    turned = 1000 + round(FREE_SPEED_RAD_S * 0.5 / RAD_PER_TICK)
    assert kept(family, watch, replies(family, turned), 0.5) == turned


# Hardware on emulated servos.


@pytest.fixture
def servos(family: Family) -> Any:
    return family.in_use()


def registers(family: Family, servos: Any, name: str) -> list[int]:
    """A register of every servo, read without the bus."""
    return [servo.value(family.registers.Register[name]) for servo in servos.emulator.servo_bus.servos]


def limits(family: Family, servos: Any) -> list[float]:
    return [family.limit(servo) for servo in servos.emulator.servo_bus.servos]


def put(family: Family, servo: Any, name: str, value: int) -> None:
    register = family.registers.Register[name]
    servo.write(register, family.registers.encode(register, value))


FULL = np.array([0.8] * 5 + [0.5])
PAN_A_LITTLE = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_relaxed_servos_have_no_goals(family: Family, servos: Any) -> None:
    assert not servos.found.driven.any()
    assert np.isnan(servos.found.goal_rad).all()
    assert servos.found.max_voltage_v == pytest.approx(family.max_voltage_v)


def test_servos_that_hold_are_found_with_their_goals(family: Family, servos: Any) -> None:
    goal_rad = servos.enable()
    found = family.in_use(servos.emulator).found
    assert found.driven.all()
    assert found.goal_rad == pytest.approx(goal_rad)


def test_goals_are_written_in_radians(servos: Any) -> None:
    servos.enable()
    servos.hardware.write_goals(PAN_A_LITTLE)
    assert servos.read(1.0).position_rad[0] == pytest.approx(0.1, abs=0.01)


def test_a_goal_that_a_servo_has_lost_is_written_again(family: Family, servos: Any) -> None:
    servos.enable()
    servos.hardware.write_goals(PAN_A_LITTLE)
    written = registers(family, servos, "GOAL_POSITION")
    put(family, servos.emulator.servo_bus.servos[0], "GOAL_POSITION", 2000)
    servos.hardware.write_goals(PAN_A_LITTLE)
    assert registers(family, servos, "GOAL_POSITION") == written


def test_a_changed_torque_limit_is_written_at_once_and_only_once(family: Family, servos: Any) -> None:
    servos.enable()
    for share in (0.5, 0.25):
        sent = servos.hardware.bus.counters.sent
        for _ in range(3):
            servos.hardware.write_torque_shares(FULL * [1, 1, 1, 1, 1, share])
        assert servos.hardware.bus.counters.sent - sent == 1
        assert limits(family, servos) == pytest.approx([0.8] * 5 + [0.5 * share], abs=0.001)


def test_relaxing_begins_with_the_torque_that_is_used(family: Family, servos: Any) -> None:
    servos.enable()
    steps = servos.hardware.relax(FULL * 0.5)
    next(steps)
    next(steps)
    assert max(limits(family, servos)) <= 0.4 + 0.001
    assert run_to_end(steps, servos.emulator.run) == []
    assert registers(family, servos, "TORQUE_ENABLE") == [0] * 6


def test_single_joints_are_switched_on_and_off(family: Family, servos: Any) -> None:
    run_to_end(servos.hardware.enable([0, 1, 5]), servos.emulator.run)
    assert registers(family, servos, "TORQUE_ENABLE") == [1, 1, 0, 0, 0, 1]
    assert run_to_end(servos.hardware.switch_off([1, 5])) == []
    assert run_to_end(servos.hardware.driven()).tolist() == [True, False, False, False, False, False]


def test_torque_is_cut_with_the_first_step(family: Family, servos: Any) -> None:
    servos.enable()
    next(servos.hardware.cut_torque())
    assert registers(family, servos, "TORQUE_ENABLE") == [0] * 6


def test_a_servo_that_does_not_confirm_that_torque_is_off_is_named(servos: Any) -> None:
    servos.enable()
    servos.emulator.servo_bus.faults.offline = {2}
    assert run_to_end(servos.hardware.cut_torque(), servos.emulator.run) == ["shoulder_lift (id 2)"]


@pytest.mark.parametrize("hold", [True, False])
def test_an_overload_is_cleared_where_the_joint_is_and_it_holds_on_or_stays_relaxed(
    family: Family, servos: Any, hold: bool
) -> None:
    goal_rad = servos.enable() if hold else None
    family.fail(servos.emulator.servo_bus.servos[3])
    assert servos.read(0.1).status[3] == StatusFlag.OVERLOAD
    held_rad = run_to_end(servos.hardware.clear_overloads([3], hold=hold), servos.emulator.run)
    assert held_rad is None if goal_rad is None else held_rad == pytest.approx(goal_rad, abs=0.03)
    assert servos.read(0.1).status[3] == 0
    assert registers(family, servos, "TORQUE_ENABLE") == [int(hold)] * 6


def test_a_silent_servo_is_not_waited_for_by_the_check(family: Family, servos: Any) -> None:
    servos.enable()
    servos.emulator.servo_bus.faults.offline = set(IDS)
    for _ in range(6 * family.readings.MISSES_UNTIL_SILENT):
        servos.hardware.read()
    sent = servos.hardware.bus.counters.sent
    assert [servos.hardware.check(0.0) for _ in range(40)] == [None] * 40
    assert servos.hardware.bus.counters.sent == sent


def test_before_every_servo_was_heard_there_is_no_reading(family: Family) -> None:
    emulator = family.emulator()
    emulator.servo_bus.faults.offline = {3}
    hardware = family.unread(emulator)
    assert hardware.read() is None
    assert hardware.condition(0).age_s < 1.0
    assert math.isinf(hardware.condition(2).age_s)


def test_the_condition_has_torque_silence_and_the_surveys_warnings(family: Family) -> None:
    emulator = family.emulator()
    put(family, emulator.servo_bus.servos[1], family.lowest_limit, 1000)
    servos = family.in_use(emulator)
    assert servos.hardware.condition(1).torque_enabled is None
    servos.enable()
    for _ in range(6 * family.checks_each * 16):
        servos.hardware.check(0.0)
    emulator.servo_bus.faults.offline = {2}
    servos.read()
    condition = servos.hardware.condition(1)
    assert (condition.hardware_id, condition.torque_enabled, condition.silent_cycles) == ("servo 2", True, 1)
    assert condition.age_s > 0.0
    (warning,) = condition.warnings
    assert "1000" in warning.sentence


def writes(emulator: Any) -> list[Any]:
    """Keep the writes that the servos get from now on, which do not take them."""
    written: list[Any] = []
    for servo in emulator.servo_bus.servos:
        servo.write = lambda *arguments: written.append(arguments)
    return written


@pytest.mark.parametrize(
    ("offline", "words"),
    [
        ({2, 5}, r"no answer from shoulder_lift \(id 2\), wrist_roll \(id 5\): check the cable"),
        (set(IDS), "no servo answers: is the arm powered"),
    ],
)
def test_missing_servos_are_named_by_a_survey_with_the_likely_cause(
    family: Family, offline: set[int], words: str
) -> None:
    emulator = family.emulator()
    written = writes(emulator)
    emulator.servo_bus.faults.offline = offline
    with pytest.raises(StartupError, match=words):
        run_to_end(family.unread(emulator).survey())
    emulator.servo_bus.faults.offline = set()
    assert list(run_to_end(family.unread(emulator).survey()).driven) == [False] * 6
    assert written == []


def test_a_relaxed_arm_is_read_and_nothing_is_written(family: Family) -> None:
    emulator = family.emulator()
    written = writes(emulator)
    rig = family.rig(emulator, start_enabled=False)
    rig.until_mode(Mode.RELAXED)
    before = rig.state.stamp_s
    rig.run(0.2)
    assert rig.state.stamp_s > before
    assert written == []


# The bus.


def block_read(family: Family, bus: Any) -> dict[int, Any]:
    """Positions of all servos, in one transaction."""
    register = family.registers.Register.PRESENT_POSITION
    frames: dict[int, Any] = bus.sync_read(IDS, register, len(family.registers.encode(register, 0)))
    return {servo: family.registers.decode(register, frame.data) for servo, frame in frames.items()}


def test_registers_and_blocks_of_several_servos_are_written_and_read(family: Family) -> None:
    emulator = family.emulator()
    bus, goal = emulator.open_bus(), family.registers.Register.GOAL_POSITION
    bus.write(3, goal, 700)
    assert [bus.read(servo, goal) for servo in (3, 4)] == [700, 0]
    sent = bus.counters.sent
    bus.sync_write(goal, {servo: family.registers.encode(goal, 100 * servo) for servo in IDS})
    assert bus.counters.sent - sent == 1
    assert [bus.read(servo, goal) for servo in IDS] == [100, 200, 300, 400, 500, 600]
    sent = bus.counters.sent
    assert list(block_read(family, bus)) == list(IDS)
    assert bus.counters.sent - sent == 1
    assert block_read(family, bus)[3] == bus.read(3, family.registers.Register.PRESENT_POSITION)


def test_a_servo_that_is_gone_is_named_and_the_others_still_answer(family: Family) -> None:
    emulator = family.emulator()
    bus = emulator.open_bus()
    emulator.servo_bus.faults.offline = {3}
    with pytest.raises(NoReply, match="servo 3 ") as silent:
        bus.read(3, family.registers.Register.TORQUE_ENABLE)
    assert silent.value.servo_id == 3
    assert isinstance(silent.value, TimeoutError)
    assert bus.counters.timeouts > 0
    assert sorted(block_read(family, bus)) == [1, 2, 4, 5, 6]
    emulator.servo_bus.faults.offline = set()
    assert bus.read(3, family.registers.Register.TORQUE_ENABLE) == 0


def test_one_broadcast_switches_all_torque_off(family: Family) -> None:
    bus, torque = family.emulator().open_bus(), family.registers.Register.TORQUE_ENABLE
    for servo in IDS:
        bus.write(servo, torque, 1)
    bus.broadcast_torque_off()
    assert [bus.read(servo, torque) for servo in IDS] == [0] * 6


def test_a_lost_port_is_told(family: Family) -> None:
    emulator = family.emulator()
    bus = emulator.open_bus()
    emulator.port.unplug()
    with pytest.raises(PortLost):
        bus.read(3, family.registers.Register.TORQUE_ENABLE)
