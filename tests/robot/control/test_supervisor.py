from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from robot.faults import FaultCode
from robot.messages import EmergencyPolicy, EndState, Mode, Order, Outcome, Shutdown
from robot.servos.registers import Register
from tests.helpers.arm_rig import ArmRig
from tests.helpers.trajectories import smooth_move
from tests.robot.conftest import RunningEmulator

Start = Callable[..., ArmRig]
PAN = smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=1.5)


@pytest.fixture
def start_rig(emulator: RunningEmulator) -> Iterator[Start]:
    rigs = []

    def start(**settings: object) -> ArmRig:
        rigs.append(ArmRig(emulator.port, **settings))
        return rigs[-1]

    yield start
    for rig in rigs:
        rig.close()


@pytest.fixture
def rig(start_rig: Start) -> ArmRig:
    made = start_rig()
    made.until_mode(Mode.HOLDING)
    return made


@pytest.fixture
def moving(rig: ArmRig) -> ArmRig:
    rig.execute(PAN)
    rig.run(0.4)
    assert rig.mode is Mode.MOVING
    return rig


def test_an_arm_is_checked_then_switched_on(start_rig: Start) -> None:
    rig = start_rig()
    assert rig.mode is Mode.CONNECTED
    rig.until_mode(Mode.HOLDING)
    assert rig.torque() == [1] * 6


def test_an_arm_that_may_not_be_switched_on_stays_relaxed(start_rig: Start) -> None:
    rig = start_rig(start_enabled=False)
    rig.until_mode(Mode.RELAXED)
    assert rig.torque() == [0] * 6
    assert rig.order(Order.ENABLE).done
    assert rig.mode is Mode.HOLDING


def test_an_arm_with_a_missing_servo_says_so_and_comes_up_when_it_is_there(
    emulator: RunningEmulator, start_rig: Start
) -> None:
    emulator.command(offline=[3])
    rig = start_rig()
    rig.until(lambda: any("elbow_flex (id 3)" in getattr(each, "reason", "") for each in rig.sent))
    assert rig.mode is Mode.CONNECTED
    emulator.command(online=[3])
    rig.until_mode(Mode.HOLDING)


def test_relaxing_stops_the_motion_first_and_ends_verified(moving: ArmRig) -> None:
    answer = moving.order(Order.RELAX)
    assert answer.done
    assert [ended.outcome for ended in moving.ended] == [Outcome.STOPPED]
    assert moving.mode is Mode.RELAXED
    assert moving.torque() == [0] * 6


def test_motions_are_refused_while_the_arm_is_being_relaxed(rig: ArmRig) -> None:
    rig.begin(Order.RELAX)
    rig.run(0.1)
    rig.execute(PAN)
    (refused,) = rig.ended
    assert refused.outcome is Outcome.REFUSED
    assert "relaxed" in refused.message


def test_an_emergency_stop_cuts_torque_within_one_tick_and_is_verified(moving: ArmRig) -> None:
    number = moving.begin(Order.EMERGENCY_STOP)
    assert moving.torque() == [0] * 6
    assert moving.fault_code == "emergency_stop"
    assert [ended.outcome for ended in moving.ended] == [Outcome.FAULT]
    moving.until(lambda: moving.answer(number) is not None)
    answer = moving.answer(number)
    assert answer is not None
    assert answer.done


def test_an_emergency_stop_that_cannot_be_verified_names_the_servo(emulator: RunningEmulator, rig: ArmRig) -> None:
    emulator.command(offline=[2])
    answer = rig.order(Order.EMERGENCY_STOP)
    assert not answer.done
    assert "shoulder_lift (id 2)" in answer.message
    assert rig.fault_code == "emergency_stop_unverified"


def test_an_emergency_stop_may_be_configured_to_hold(start_rig: Start) -> None:
    rig = start_rig(on_emergency_stop=EmergencyPolicy.HOLD)
    rig.until_mode(Mode.HOLDING)
    rig.execute(PAN)
    rig.run(0.4)
    assert rig.order(Order.EMERGENCY_STOP).done
    assert rig.torque() == [1] * 6
    goal = rig.state.goal_rad
    rig.run(0.1)
    assert rig.state.goal_rad == pytest.approx(goal, abs=0.03)


def test_an_emergency_stop_interrupts_every_other_order(start_rig: Start) -> None:
    rig = start_rig(start_enabled=False)
    rig.until_mode(Mode.RELAXED)
    enabling = rig.begin(Order.ENABLE)
    rig.run(0.3)
    assert rig.order(Order.EMERGENCY_STOP).done
    interrupted = rig.answer(enabling)
    assert interrupted is not None
    assert not interrupted.done
    rig.run(0.3)
    assert rig.torque() == [0] * 6


def test_an_emergency_stop_during_the_start_keeps_the_arm_off(start_rig: Start) -> None:
    rig = start_rig()
    rig.run(0.02)
    assert rig.mode is Mode.CONNECTED
    assert rig.order(Order.EMERGENCY_STOP).done
    rig.run(0.5)
    assert rig.mode is Mode.FAULT
    assert rig.torque() == [0] * 6


def test_after_a_reset_an_emergency_stopped_arm_is_relaxed_until_it_is_enabled(rig: ArmRig) -> None:
    rig.order(Order.EMERGENCY_STOP)
    assert not rig.order(Order.ENABLE).done
    assert rig.order(Order.RESET_FAULT).done
    assert rig.mode is Mode.RELAXED
    assert rig.order(Order.ENABLE).done
    assert rig.mode is Mode.HOLDING


def test_a_second_order_is_refused_while_one_is_carried_out(start_rig: Start) -> None:
    rig = start_rig(start_enabled=False)
    rig.until_mode(Mode.RELAXED)
    rig.begin(Order.ENABLE)
    answer = rig.answer(rig.begin(Order.RESET_FAULT))
    assert answer is not None
    assert "enabling" in answer.message


def test_a_silent_servo_is_a_fault_that_goes_when_it_answers_again(emulator: RunningEmulator, moving: ArmRig) -> None:
    emulator.command(offline=[3])
    moving.until_mode(Mode.FAULT)
    assert moving.fault_code == "servo_silent"
    assert [ended.outcome for ended in moving.ended] == [Outcome.BUS_LOST]
    assert not moving.order(Order.RESET_FAULT).done
    emulator.command(online=[3])
    moving.run(0.2)
    assert moving.order(Order.RESET_FAULT).done
    assert moving.mode is Mode.HOLDING


def test_a_servo_that_started_anew_is_found_within_a_second(emulator: RunningEmulator, rig: ArmRig) -> None:
    emulator.command(power_cycle=[2])
    started_s = time.monotonic()
    rig.until_mode(Mode.FAULT)
    assert time.monotonic() - started_s < 1.2
    assert rig.fault_code == "servo_rebooted"
    assert rig.order(Order.RESET_FAULT).done
    assert rig.torque() == [1] * 6


def test_torque_switched_off_by_somebody_else_is_found(rig: ArmRig) -> None:
    assert rig.bus is not None
    rig.bus.write(4, Register.TORQUE_ENABLE, 0)
    rig.until_mode(Mode.FAULT)
    assert rig.fault_code == "torque_lost"
    assert "wrist_flex" in str(rig.supervisor.fault)


def test_a_silent_server_stops_the_arm_which_goes_on_when_it_is_back(moving: ArmRig) -> None:
    moving.alive = False
    moving.until(lambda: moving.mode is Mode.HOLDING)
    assert [ended.outcome for ended in moving.ended] == [Outcome.STOPPED]
    moving.alive = True
    moving.tick()
    assert moving.state.goal_rad is not None
    here = float(moving.state.goal_rad[0])
    moving.execute(smooth_move({"shoulder_pan": (here, here - 0.2)}, 0.5), motion_id=2)
    moving.until(lambda: len(moving.ended) == 2)
    assert moving.ended[1].outcome is Outcome.REACHED


def test_a_silent_server_leaves_a_relaxed_arm_where_so_configured(start_rig: Start) -> None:
    rig = start_rig(on_server_lost=EndState.RELAX)
    rig.until_mode(Mode.HOLDING)
    rig.alive = False
    rig.until(lambda: rig.mode is Mode.RELAXED)
    assert rig.torque() == [0] * 6


@pytest.mark.parametrize(("end", "torque"), [(EndState.HOLD, [1] * 6), (EndState.RELAX, [0] * 6)])
def test_at_its_end_the_arm_is_left_as_configured(start_rig: Start, end: EndState, torque: list[int]) -> None:
    rig = start_rig(on_exit=end)
    rig.until_mode(Mode.HOLDING)
    rig.execute(PAN)
    rig.run(0.3)
    rig.supervisor.obey(Shutdown(), time.monotonic())
    rig.until(lambda: rig.supervisor.finished(time.monotonic()))
    assert [ended.outcome for ended in rig.ended] == [Outcome.STOPPED]
    assert rig.torque() == torque


def test_a_lost_bus_ends_the_motion_and_a_new_one_adopts_the_arm(moving: ArmRig) -> None:
    moving.close()
    moving.supervisor.disconnect("serial port was lost")
    assert moving.mode is Mode.DISCONNECTED
    assert [ended.outcome for ended in moving.ended] == [Outcome.BUS_LOST]
    moving.execute(PAN, motion_id=2)
    assert moving.ended[1].outcome is Outcome.BUS_LOST
    moving.connect()
    moving.until_mode(Mode.HOLDING)
    assert moving.torque() == [1] * 6


def test_an_arm_found_relaxed_after_a_lost_bus_is_not_switched_on(emulator: RunningEmulator, rig: ArmRig) -> None:
    rig.close()
    rig.supervisor.disconnect("serial port was lost")
    emulator.command(power_cycle=[1, 2, 3, 4, 5, 6])
    rig.connect()
    rig.until(lambda: rig.mode is Mode.RELAXED)
    rig.run(0.3)
    assert rig.torque() == [0] * 6


def test_a_latched_fault_outlives_the_bus(rig: ArmRig) -> None:
    rig.order(Order.EMERGENCY_STOP)
    rig.close()
    rig.supervisor.disconnect("serial port was lost")
    rig.connect()
    rig.until_mode(Mode.FAULT)
    assert rig.supervisor.fault is not None
    assert rig.supervisor.fault.code is FaultCode.EMERGENCY_STOP


def test_orders_to_an_arm_that_is_not_connected_are_refused(rig: ArmRig) -> None:
    rig.close()
    rig.supervisor.disconnect("serial port was lost")
    for order in Order:
        answer = rig.answer(rig.begin(order))
        assert answer is not None
        assert not answer.done
        assert "serial port was lost" in answer.message


def test_a_gripper_moves_beside_the_arm(rig: ArmRig) -> None:
    rig.execute(PAN, motion_id=1)
    rig.execute(smooth_move({"gripper": (0.0, 0.6)}, 1.0), motion_id=2, torque_share=0.5)
    rig.run(0.3)
    assert rig.bus is not None
    assert rig.bus.read(6, Register.TORQUE_LIMIT) == 250
    rig.until(lambda: len(rig.ended) == 2)
    assert {ended.outcome for ended in rig.ended} == {Outcome.REACHED}
    assert rig.bus.read(6, Register.TORQUE_LIMIT) == 500


def test_health_is_told_once_a_second_with_the_limits_kept(rig: ArmRig) -> None:
    rig.run(1.1)
    health = rig.health
    assert [servo.joint for servo in health.servos] == list(rig.supervisor.servos.names)
    assert health.limits_rad is not None
    assert health.limits_rad.shape == (6, 2)
    assert 0.0 < health.round_trip_s[0] < 0.01


def test_an_arm_with_adopted_servos_only_in_part_is_a_fault_after_a_reconnect(
    emulator: RunningEmulator, rig: ArmRig
) -> None:
    rig.close()
    rig.supervisor.disconnect("serial port was lost")
    emulator.command(power_cycle=[5])
    rig.connect()
    rig.until_mode(Mode.FAULT)
    assert "wrist_roll (id 5)" in str(rig.supervisor.fault)
    assert rig.torque() == [1, 1, 1, 1, 0, 1]


def test_an_emergency_stop_before_the_arm_is_there_keeps_it_from_being_switched_on(start_rig: Start) -> None:
    rig = start_rig()
    rig.close()
    rig.supervisor.disconnect("serial port was lost")
    rig.begin(Order.EMERGENCY_STOP)
    rig.connect()
    rig.until_mode(Mode.RELAXED)
    assert rig.torque() == [0] * 6
