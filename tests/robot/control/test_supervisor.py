import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robot.control.cycle import ControlCycle
from robot.control.pacing import Pacer, Scheduling
from robot.control.supervisor import arm_health, arm_state
from robot.description.limits import within_calibration
from robot.emulator.populations import POPULATIONS
from robot.errors import PortError
from robot.hardware.config import EmulatedConfig, HardwareConfig, IdealConfig, SerialConfig
from robot.hardware.feetech.registers import Register
from robot.messages import (
    END_LIMIT_S,
    ArmHealth,
    ArmState,
    ChangePace,
    Command,
    Commanded,
    EmergencyPolicy,
    EndState,
    Heartbeat,
    Mode,
    Order,
    Outcome,
    Setpoint,
    Shutdown,
    Stop,
    Stream,
)
from robot.trajectory import PERIOD_S
from tests.helpers.arm_rig import CALIBRATION, METAL, NAMES, ArmRig, unread_hardware
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.motions import smooth_move
from tests.helpers.robots import recalibrated, so101

Start = Callable[..., ArmRig]
PAN = smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=1.5)
SIMULATED = [EmulatedConfig(CALIBRATION), IdealConfig()]
LOST = "serial port was lost"
FALLEN_TICKS = 150


@pytest.fixture
def start_rig(emulator: SteppedEmulator) -> Start:
    return lambda **settings: ArmRig(emulator, **settings).started()


@pytest.fixture
def rig(start_rig: Start) -> ArmRig:
    return start_rig()


@pytest.fixture
def moving(rig: ArmRig) -> ArmRig:
    rig.execute(PAN)
    rig.run(0.4)
    assert rig.mode is Mode.MOVING
    return rig


def test_an_arm_that_was_not_read_has_no_positions(emulator: SteppedEmulator) -> None:
    arm = ControlCycle(unread_hardware(emulator), emulator.clock)
    state = arm_state(arm, Mode.CONNECTED, "", (), emulator.clock)
    assert state.position_rad is None
    health = arm_health(arm, state, "port", Pacer(0.0), emulator.clock, Scheduling())
    assert all(math.isnan(joint.position_rad) and joint.warnings for joint in health.joints)


def test_a_state_has_the_time_of_its_tick_and_health_once_a_second_the_limits_in_force(rig: ArmRig) -> None:
    rig.sent.clear()
    rig.until(lambda: any(isinstance(each, ArmState) for each in rig.sent))
    assert rig.state.tick_s == rig.clock()
    assert rig.state.motions == ()
    rig.run(1.1)
    assert [joint.joint for joint in rig.health.joints] == list(NAMES)
    assert rig.health.limits_rad.shape == (6, 2)
    assert rig.health.bus.replies > 600


def test_what_the_hardware_does_not_have_or_measure_is_not_in_its_health() -> None:
    rig = ArmRig(hardware=IdealConfig())
    rig.run(1.5)
    assert rig.health.bus is None
    for joint in rig.health.joints:
        assert all(map(math.isnan, (joint.temperature_c, joint.voltage_v, joint.current_a)))
        assert math.isfinite(joint.position_rad)
        assert joint.warnings == ()


def test_an_arm_is_checked_then_switched_on_or_stays_relaxed_until_it_may_be(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator)
    assert rig.mode is Mode.CONNECTED
    rig.until_mode(Mode.HOLDING)
    assert rig.torque() == [1] * 6
    assert rig.order(Order.RELAX).done
    rig = ArmRig(emulator, start_enabled=False).started()
    assert rig.torque() == [0] * 6
    assert rig.order(Order.ENABLE).done
    assert rig.mode is Mode.HOLDING


def lines(caplog: pytest.LogCaptureFixture, words: str) -> list[str]:
    return [line for line in caplog.messages if words in line]


def test_an_arm_reports_a_missing_servo_and_comes_up_with_it(
    emulator: SteppedEmulator, caplog: pytest.LogCaptureFixture
) -> None:
    emulator.command(offline=[3])
    rig = ArmRig(emulator)
    checked_s: list[float] = []
    for _ in range(1200):
        rig.tick()
        if len(lines(caplog, "checking the servos: ")) > len(checked_s):
            checked_s.append(rig.clock())
    # Ever later, up to two seconds.
    assert np.diff(np.diff(checked_s))[:5] == pytest.approx([0.2, 0.4, 0.8, 0.4, 0.0], abs=0.02)
    assert "elbow_flex (id 3)" in rig.state.reason
    assert rig.mode is Mode.CONNECTED
    rig.execute(PAN)
    assert rig.outcomes == [Outcome.REFUSED]
    assert rig.ended[0].message.startswith("the servos are still being checked: no answer from elbow_flex (id 3)")
    rig.until(lambda: len(lines(caplog, "checking the servos: ")) > len(checked_s))
    assert rig.refused(Order.ENABLE) == "the servos are still being checked"
    emulator.command(online=[3])
    rig.until_mode(Mode.HOLDING)


def test_an_arm_whose_joints_cannot_be_read_for_two_seconds_is_refused_and_a_port_that_is_lost_is_no_refusal(
    emulator: SteppedEmulator, caplog: pytest.LogCaptureFixture
) -> None:
    rig = ArmRig(emulator)
    rig.supervisor.arm.hardware.read = lambda: None
    rig.run(1.9)
    assert not lines(caplog, "checking the servos")
    rig.run(0.3)
    assert lines(caplog, "checking the servos: not every servo can be read")
    rig.connect()
    rig.tick()
    emulator.port.unplug()
    with pytest.raises(PortError):
        max(rig.supervisor.work() for _ in range(10))


def test_relaxing_stops_the_motion_first_refuses_others_and_ends_verified(moving: ArmRig) -> None:
    number = moving.begin(Order.RELAX)
    moving.until(lambda: bool(moving.ended))
    moving.run(0.1)
    moving.execute(PAN, motion_id=2)
    assert moving.outcomes == [Outcome.STOPPED, Outcome.REFUSED]
    assert "being relaxed" in moving.ended[1].message
    assert (moving.state.reason, moving.state.task) == ("it is being relaxed", "relaxing")
    assert moving.wait(number).done
    assert (moving.mode, moving.torque()) == (Mode.RELAXED, [0] * 6)


def test_an_emergency_stop_cuts_torque_in_one_tick_is_verified_and_its_reset_enables_nothing(
    moving: ArmRig, caplog: pytest.LogCaptureFixture
) -> None:
    number = moving.begin(Order.EMERGENCY_STOP)
    assert moving.torque() == [0] * 6
    assert moving.fault_code == "emergency_stop"
    assert moving.outcomes == [Outcome.FAULT]
    assert moving.wait(number).done
    assert len(lines(caplog, "emergency stop: torque is off")) == 1
    assert not moving.order(Order.ENABLE).done
    for order, mode in ((Order.RESET_FAULT, Mode.RELAXED), (Order.ENABLE, Mode.HOLDING)):
        assert moving.order(order).done
        assert moving.mode is mode


def test_an_emergency_stop_that_cannot_be_verified_names_the_servo(emulator: SteppedEmulator, rig: ArmRig) -> None:
    emulator.command(offline=[2])
    assert "shoulder_lift (id 2)" in rig.refused(Order.EMERGENCY_STOP)
    assert rig.fault_code == "emergency_stop_unverified"


def test_a_second_order_is_refused_while_one_is_carried_out_except_an_emergency_stop(start_rig: Start) -> None:
    rig = start_rig(start_enabled=False)
    enabling = rig.begin(Order.ENABLE)
    assert "enabling" in rig.answer(rig.begin(Order.RESET_FAULT)).message
    rig.run(0.3)
    stop = rig.begin(Order.EMERGENCY_STOP)
    assert not rig.answer(enabling).done
    assert "emergency stop" in rig.answer(rig.begin(Order.RELAX)).message
    assert rig.wait(stop).done
    rig.run(0.3)
    assert rig.torque() == [0] * 6


def test_an_arm_that_is_being_enabled_can_be_relaxed(start_rig: Start) -> None:
    rig = start_rig(start_enabled=False)
    enabling = rig.begin(Order.ENABLE)
    rig.run(0.1)
    assert rig.order(Order.RELAX).done
    assert rig.answer(enabling).message == "given up for another order: relaxing"
    assert (rig.mode, rig.torque()) == (Mode.RELAXED, [0] * 6)


def test_a_stop_during_its_start_or_while_it_is_enabled_leaves_an_arm_relaxed(emulator: SteppedEmulator) -> None:
    # While its servos are checked, and until their torque has risen.
    for at_s in (0.02, 0.08, 0.2, 0.5, 0.8):
        rig = ArmRig(emulator)
        rig.run(at_s)
        assert rig.mode is Mode.CONNECTED
        rig.supervisor.handle(Stop(epoch=2))
        rig.run(2.0)
        assert (rig.mode, rig.torque()) == (Mode.RELAXED, [0] * 6), at_s
    rig = ArmRig(emulator)
    rig.supervisor.disconnect(LOST)
    rig.supervisor.handle(Stop(epoch=2))
    rig.connect()
    rig.until_mode(Mode.RELAXED)
    # Until torque rises.
    for at_s in (0.0, 0.1, 0.3, 0.5):
        rig.supervisor.handle(Command(enabling := round(100 + 10 * at_s), Order.ENABLE, epoch=100))
        rig.run(at_s)
        rig.supervisor.handle(Stop(epoch=3 + round(10 * at_s)))
        assert rig.answer(enabling).message == "given up for another order: relaxing after a stop"
        assert rig.order(Order.RELAX).done
        assert (rig.mode, rig.torque()) == (Mode.RELAXED, [0] * 6), at_s


def test_a_stop_just_after_an_enabled_arm_was_enabled_once_more_leaves_it_holding(rig: ArmRig) -> None:
    rig.supervisor.handle(Command(100, Order.ENABLE, epoch=100))
    rig.supervisor.handle(Stop(epoch=2))
    rig.run(3.0)
    assert rig.answer(100).message == "the arm is enabled already"
    assert (rig.mode, rig.torque()) == (Mode.HOLDING, [1] * 6)


@pytest.mark.parametrize("stop", [Stop(epoch=2), Command(99, Order.EMERGENCY_STOP, epoch=2)])
def test_a_stop_while_a_fault_is_reset_switches_no_joint_on_and_moves_none(stop: Stop | Command) -> None:
    # Until the torque of the joint that has lost it has risen.
    for at_s in (0.0, 0.05, 0.1, 0.2, 0.4, 0.6):
        rig = ArmRig(on_emergency_stop=EmergencyPolicy.HOLD).started()
        rig.emulator.command(power_cycle=[2])
        rig.until(lambda rig=rig: rig.mode is Mode.FAULT, timeout_s=1.2)
        fallen = rig.bus.read(2, Register.PRESENT_POSITION) + FALLEN_TICKS
        rig.emulator.command(hand={"2": fallen})
        rig.run(0.5)
        rig.emulator.command(hand={"2": None})
        number = rig.begin(Order.RESET_FAULT)
        rig.run(at_s)
        before = rig.torque()
        rig.supervisor.handle(stop)
        assert rig.wait(number).message.startswith("given up"), at_s
        rig.run(1.0)
        assert (rig.mode, rig.torque()) == (Mode.FAULT, before), at_s
        if before[1]:
            assert rig.bus.read(2, Register.PRESENT_POSITION) == pytest.approx(fallen, abs=20), at_s
        rig.supervisor.handle(Command(100, Order.RESET_FAULT, epoch=3))
        assert rig.wait(100).done
        assert rig.torque() == [1] * 6


def test_neither_a_stop_nor_a_second_order_to_relax_makes_an_arm_sink_faster_or_not_at_all(rig: ArmRig) -> None:
    number = rig.begin(Order.RELAX)
    rig.run(0.5)
    rig.supervisor.handle(Stop(epoch=2))
    assert rig.refused(Order.RELAX) == "the arm is busy: relaxing"
    rig.run(0.3)
    assert rig.torque() == [1] * 6
    assert rig.wait(number).done
    assert (rig.mode, rig.torque()) == (Mode.RELAXED, [0] * 6)


def test_setpoints_steer_a_stream_whose_goals_are_sent_at_every_tick_and_other_streams_are_not_steered(
    rig: ArmRig,
) -> None:
    rig.supervisor.handle(Stream(1, ("shoulder_pan",)))
    for _ in range(50):
        rig.supervisor.handle(Setpoint(1, np.array([0.5])))
        rig.supervisor.handle(Setpoint(2, np.array([-0.5])))
        rig.tick()
    goals = [each.position_rad[0] for each in rig.sent if isinstance(each, Commanded)]
    assert len(goals) == 50
    assert goals[-1] == pytest.approx(0.5 * 0.5, abs=0.05)


def test_an_emergency_stop_during_the_start_or_before_the_arm_is_there_keeps_it_off(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator)
    rig.run(0.02)
    assert rig.mode is Mode.CONNECTED
    assert rig.order(Order.EMERGENCY_STOP).done
    rig.run(0.5)
    assert (rig.mode, rig.torque()) == (Mode.FAULT, [0] * 6)
    rig = ArmRig(emulator)
    rig.supervisor.disconnect(LOST)
    rig.begin(Order.EMERGENCY_STOP)
    rig.connect()
    rig.until_mode(Mode.RELAXED)
    assert rig.torque() == [0] * 6


def test_a_silent_servo_is_a_fault_that_goes_when_it_answers_again(emulator: SteppedEmulator, moving: ArmRig) -> None:
    emulator.command(offline=[3])
    moving.until_mode(Mode.FAULT)
    assert moving.fault_code == "servo_silent"
    assert moving.outcomes == [Outcome.BUS_LOST]
    assert moving.refused(Order.RESET_FAULT) == "the servo of joint elbow_flex (id 3) does not answer"
    emulator.command(online=[3])
    moving.run(0.2)
    assert moving.order(Order.RESET_FAULT).done
    assert moving.mode is Mode.HOLDING


def test_a_servo_that_started_anew_is_found_within_a_second(emulator: SteppedEmulator, rig: ArmRig) -> None:
    emulator.command(power_cycle=[2])
    rig.until(lambda: rig.mode is Mode.FAULT, timeout_s=1.2)
    assert rig.fault_code == "servo_rebooted"
    assert rig.order(Order.RESET_FAULT).done
    assert rig.torque() == [1] * 6


def assert_stopped_until_the_server_stops_all(rig: ArmRig, standstill: str) -> None:
    """Assert that the arm refuses each motion with the standstill's sentence, and takes one after the next stop."""
    assert rig.state.halted.startswith(standstill)
    here = float(rig.state.goal_rad[0])
    rig.sent.clear()
    back = smooth_move({"shoulder_pan": (here, here - 0.2)}, 0.5)
    rig.execute(back, motion_id=2)
    rig.supervisor.handle(Stream(3, PAN.joint_names))
    assert [(each.outcome, each.message.startswith(standstill)) for each in rig.ended] == [(Outcome.STOPPED, True)] * 2
    # A brake, or the stop of one motion, is none of all.
    for stop in (Stop(), Stop(motion_id=2)):
        rig.supervisor.handle(stop)
    rig.execute(back, motion_id=4)
    rig.supervisor.handle(Stop(epoch=1))
    rig.execute(back, motion_id=5, epoch=1)
    rig.until(lambda: len(rig.ended) == 4)
    assert rig.outcomes[2:] == [Outcome.STOPPED, Outcome.REACHED]
    assert rig.state.halted == ""


def test_a_silent_server_stops_the_arm_which_takes_motions_again_once_that_has_taken_note(moving: ArmRig) -> None:
    moving.alive = False
    moving.until_mode(Mode.HOLDING)
    assert moving.outcomes == [Outcome.STOPPED]
    moving.alive = True
    moving.tick()
    assert_stopped_until_the_server_stops_all(moving, "nothing was heard of the server for 0.5 s")


def test_a_silent_server_stops_an_arm_at_rest_later(rig: ArmRig) -> None:
    rig.alive = False
    rig.run(4.9)
    assert rig.state.halted == ""
    rig.run(0.2)
    rig.alive = True
    assert_stopped_until_the_server_stops_all(rig, "nothing was heard of the server for 5.0 s")


@pytest.mark.parametrize("hardware", [METAL, *SIMULATED])
@pytest.mark.parametrize("moves", [True, False])
def test_an_arm_whose_process_stood_still_brakes_and_does_not_go_on(
    start_rig: Start, hardware: HardwareConfig, moves: bool
) -> None:
    rig = start_rig(hardware=hardware)
    limit_s = 0.5 if moves and hardware is METAL else 5.0
    if moves:
        rig.execute(PAN)
        rig.run(0.4)
    for share, halted in ((0.9, ""), (1.1, f"the arm process stood still for {1.1 * limit_s:.1f} s")):
        rig.clock.advance(share * limit_s)
        rig.tick()
        assert rig.state.halted == halted
    rig.until_mode(Mode.HOLDING)
    assert rig.outcomes == [Outcome.STOPPED] * moves
    assert rig.state.goal_rad[0] < 0.6
    assert_stopped_until_the_server_stops_all(rig, "the arm process stood still for ")


@pytest.mark.parametrize(
    ("settings", "waits_s"),
    [
        ({"watchdog_s": 0.7}, 0.7),
        *(({"hardware": hardware, "watchdog_s": 0.5}, 5.0) for hardware in SIMULATED),
        ({"hardware": SIMULATED[0], "watchdog_s": 8.0}, 8.0),
        # Its clock runs twice as fast as the server's.
        ({"hardware": replace(SIMULATED[0], rate=2.0)}, 10.0),
    ],
)
def test_an_arm_waits_for_its_server_as_configured(start_rig: Start, settings: dict[str, Any], waits_s: float) -> None:
    rig = start_rig(**settings)
    rig.execute(smooth_move({"shoulder_pan": (0.0, 1.0)}, duration_s=30.0))
    rig.run(0.4)
    rig.alive = False
    since_s = rig.clock()
    rig.until(lambda: rig.mode is Mode.HOLDING, timeout_s=20.0)
    assert rig.clock() - since_s == pytest.approx(waits_s, abs=0.3)


def silent_servers(rig: ArmRig, caplog: pytest.LogCaptureFixture, times: int) -> list[str]:
    """Lines of the log about a server that falls silent and comes back a number of times."""
    caplog.clear()
    for _ in range(times):
        rig.alive = False
        rig.run(1.0)
        rig.alive = True
        rig.run(0.1)
    return lines(caplog, "nothing heard")


def test_log_lines_about_silences_of_the_server_are_limited(rig: ArmRig, caplog: pytest.LogCaptureFixture) -> None:
    written = silent_servers(rig, caplog, 5)
    assert len(written) == 3
    assert all(line.endswith("nothing moves") for line in written)
    rig.clock.advance(600.0)
    rig.run(0.1)
    (later,) = silent_servers(rig, caplog, 1)
    assert later.endswith("nothing moves (2 more lines like this were left out before)")


def test_an_arm_reacts_to_a_silent_server_as_configured(start_rig: Start, caplog: pytest.LogCaptureFixture) -> None:
    for reaction, words in ((EndState.HOLD, "s: stopping"), (EndState.RELAX, "s: relaxing")):
        rig = start_rig(on_server_lost=reaction)
        if reaction is EndState.HOLD:
            rig.execute(PAN)
            rig.run(0.4)
        (line,) = silent_servers(rig, caplog, 1)
        assert line.endswith(words)
    rig.alive = False
    rig.until_mode(Mode.RELAXED)
    assert rig.torque() == [0] * 6


@pytest.mark.parametrize("hardware", SIMULATED)
def test_a_simulated_arm_at_rest_can_spare_a_tick_and_four_while_nobody_sees_it_but_a_real_one_none(
    emulator: SteppedEmulator, hardware: HardwareConfig
) -> None:
    rig = ArmRig(emulator, hardware=hardware)
    assert rig.supervisor.spare_ticks == 0
    rig.started().tick()
    assert rig.supervisor.spare_ticks == 1
    rig.run(1.0)
    for observed, spare in ((False, 4), (True, 1), (False, 4)):
        rig.observed = observed
        rig.tick()
        assert rig.supervisor.spare_ticks == spare
    rig.execute(PAN)
    assert rig.supervisor.spare_ticks == 0
    rig.until(lambda: bool(rig.ended))
    assert rig.supervisor.spare_ticks <= 1
    rig.run(0.6)
    assert rig.supervisor.spare_ticks == 4
    rig.begin(Order.RELAX)
    assert rig.supervisor.spare_ticks == 0
    # Emulated servos that lose replies do not stay at rest by themselves.
    for other, spare in ((METAL, 0), (EmulatedConfig(CALIBRATION, drop=0.001), 1)):
        assert at_rest_unseen(hardware=other).supervisor.spare_ticks == spare


def at_rest_unseen(**config: Any) -> ArmRig:
    """An arm that has held for a second, and whose states nobody sees."""
    rig = ArmRig(**config).started()
    rig.run(1.0)
    rig.observed = False
    rig.tick()
    return rig


def tick_by(rig: ArmRig, ticks: int, times: int) -> list[object]:
    """Tick a number of times, so many periods apart; return what is sent."""
    rig.sent.clear()
    for _ in range(times):
        rig.clock.advance(ticks * PERIOD_S)
        rig.supervisor.tick(rig.pacer, ticks=ticks, server_gone=False)
    return rig.sent


def test_skipped_ticks_make_states_no_rarer_and_states_left_out_are_not_made_up_for(start_rig: Start) -> None:
    seen = tick_by(start_rig(hardware=SIMULATED[0], state_rate_hz=50.0), 2, 100)
    assert [sum(isinstance(each, kind) for each in seen) for kind in (ArmState, ArmHealth)] == [100, 2]
    # Of the machine's time no more than 200 a second: here a tenth of the arm's.
    seen = tick_by(start_rig(hardware=replace(SIMULATED[0], rate=10.0), state_rate_hz=100.0), 1, 100)
    assert sum(isinstance(each, ArmState) for each in seen) == 20
    rig = at_rest_unseen(hardware=SIMULATED[0], state_rate_hz=50.0)
    tick_by(rig, 5, 20)
    assert sum(isinstance(each, ArmState) for each in tick_by(rig, 1, 20)) in (10, 11)


@pytest.mark.parametrize("order", [Order.EMERGENCY_STOP, Order.RELAX])
def test_the_remedy_of_a_simulated_arm_without_answers_asks_for_no_hands(
    emulator: SteppedEmulator, start_rig: Start, order: Order
) -> None:
    rig = start_rig(hardware=SIMULATED[0])
    emulator.command(offline=[2])
    assert not rig.order(order).done
    assert "online" in rig.supervisor.fault.remedy


@pytest.mark.parametrize(("end", "torque"), [(EndState.HOLD, [1] * 6), (EndState.RELAX, [0] * 6)])
def test_at_its_end_the_arm_is_left_as_configured(start_rig: Start, end: EndState, torque: list[int]) -> None:
    rig = start_rig(on_exit=end)
    rig.execute(PAN)
    rig.run(0.3)
    rig.supervisor.handle(Shutdown())
    rig.execute(smooth_move({"gripper": (0.0, 0.5)}, 1.0), motion_id=2)
    assert rig.ended[0].message == "the arm process is ending"
    rig.until(lambda: rig.supervisor.finished())
    assert rig.outcomes == [Outcome.REFUSED, Outcome.STOPPED]
    assert rig.torque() == torque


def test_servos_that_hold_are_relaxed_also_where_the_end_comes_before_they_are_checked(start_rig: Start) -> None:
    following = ArmRig(start_rig().emulator, on_exit=EndState.RELAX)
    following.supervisor.handle(Shutdown())
    following.until(following.supervisor.finished)
    assert following.torque() == [0] * 6


def end_starved(rig: ArmRig, tick_s: float) -> None:
    """Bring the arm to its end on a machine on which each tick, and a step of a sequence, takes so long."""
    rig.supervisor.handle(Shutdown())
    while not rig.supervisor.finished():
        rig.clock.advance(tick_s)
        rig.supervisor.work()
        rig.pacer.start_tick(rig.clock())
        rig.supervisor.handle(Heartbeat(observed=True))
        rig.supervisor.tick(rig.pacer, server_gone=False)


def test_a_starved_arm_has_the_time_of_its_end_in_ticks(start_rig: Start) -> None:
    rig = start_rig(on_exit=EndState.RELAX)
    end_starved(rig, tick_s=0.1)
    assert rig.torque() == [0] * 6


def test_an_arm_late_in_its_end_state_reports_torque_or_where_it_may_be_on(
    emulator: SteppedEmulator, start_rig: Start, caplog: pytest.LogCaptureFixture
) -> None:
    rig = start_rig(on_exit=EndState.RELAX)
    rig.bus.write(2, Register.TORQUE_ENABLE, 0)
    end_starved(rig, END_LIMIT_S)
    (line,) = lines(caplog, "end state")
    assert "torque is on at shoulder_pan (id 1), elbow_flex (id 3), " in line
    assert "Hold the arm, and switch the servos' supply off" in line
    rig = start_rig(on_exit=EndState.RELAX)
    emulator.command(offline=[1, 2, 3, 4, 5, 6])
    end_starved(rig, END_LIMIT_S)
    _, line = lines(caplog, "end state")
    assert "torque may be on at every joint: " in line


def test_an_arm_that_is_not_relaxed_within_5_s_of_ticks_is_left(
    start_rig: Start, caplog: pytest.LogCaptureFixture
) -> None:
    rig = start_rig(on_exit=EndState.RELAX)
    for servo in range(1, 7):
        rig.bus.write(servo, Register.TORQUE_ENABLE, 0)
    rig.supervisor.handle(Shutdown())
    for _ in range(501):
        assert not rig.supervisor.finished()
        # No sequence gets a step.
        tick_by(rig, 1, 1)
    assert rig.supervisor.finished()
    (line,) = lines(caplog, "end state")
    assert "(relax) after 5 s, in which it had 501 ticks; the process ends: torque is off at every joint" in line


@pytest.mark.parametrize("end", [EndState.RELAX, EndState.HOLD])
def test_an_arm_that_is_lost_with_torque_on_is_reported_once_at_its_end(
    start_rig: Start, caplog: pytest.LogCaptureFixture, end: EndState
) -> None:
    rig = start_rig(on_exit=end)
    rig.supervisor.disconnect(LOST)
    rig.supervisor.handle(Shutdown())
    assert [rig.supervisor.finished() for _ in range(2)] == [True, True]
    written = lines(caplog, "end state")
    assert len(written) == (end is EndState.RELAX)
    for line in written:
        assert f"torque may be on at every joint: the arm is not connected: {LOST}. Hold the arm" in line


def test_a_lost_bus_ends_the_motion_refuses_orders_and_a_new_one_adopts_the_arm_as_it_is_found(
    emulator: SteppedEmulator, caplog: pytest.LogCaptureFixture, start_rig: Start
) -> None:
    caplog.set_level(logging.INFO)
    moving = start_rig()
    moving.execute(PAN)
    moving.run(0.4)
    moving.supervisor.disconnect(LOST)
    assert moving.mode is Mode.DISCONNECTED
    moving.execute(PAN, motion_id=2)
    assert moving.outcomes == [Outcome.BUS_LOST] * 2
    moving.connect()
    moving.until_mode(Mode.HOLDING)
    assert moving.torque() == [1] * 6
    assert lines(caplog, "checking the servos: ") == [
        f"checking the servos: the arm {how}" for how in ("holds", "was holding")
    ]
    moving.supervisor.disconnect(LOST)
    emulator.command(power_cycle=[1, 2, 3, 4, 5, 6])
    moving.connect()
    moving.until_mode(Mode.RELAXED)
    moving.run(0.3)
    assert moving.torque() == [0] * 6
    # Last, because an emergency stop alone keeps an arm from being switched on.
    moving.supervisor.disconnect(LOST)
    for order in Order:
        answer = moving.answer(moving.begin(order))
        assert not answer.done, order
        assert LOST in answer.message, order


def test_a_latched_fault_and_a_speed_limit_outlive_the_bus(rig: ArmRig) -> None:
    rig.supervisor.handle(ChangePace(speed_limit=0.5))
    rig.order(Order.EMERGENCY_STOP)
    rig.supervisor.disconnect(LOST)
    rig.connect()
    rig.run(0.5)
    assert (rig.mode, rig.fault_code, rig.state.pace.speed_limit) == (Mode.FAULT, "emergency_stop", 0.5)


def test_an_arm_adopted_only_in_part_is_a_fault_after_a_reconnect(emulator: SteppedEmulator, rig: ArmRig) -> None:
    rig.supervisor.disconnect(LOST)
    emulator.command(power_cycle=[5])
    rig.connect()
    rig.until_mode(Mode.FAULT)
    assert "wrist_roll (id 5)" in str(rig.supervisor.fault)
    assert rig.torque() == [1, 1, 1, 1, 0, 1]


def test_a_motion_requested_before_the_last_stop_does_not_begin(rig: ArmRig) -> None:
    rig.supervisor.handle(Stop(epoch=7))
    rig.execute(PAN, 1, epoch=6)
    rig.supervisor.handle(Stream(2, PAN.joint_names, epoch=6))
    assert [(ended.motion_id, ended.outcome) for ended in rig.ended] == [(1, Outcome.STOPPED), (2, Outcome.STOPPED)]
    # The stop of one motion begins no epoch.
    rig.supervisor.handle(Stop(motion_id=5))
    rig.execute(PAN, 3, epoch=7)
    rig.until(lambda: len(rig.ended) == 3)
    assert rig.outcomes[2] is Outcome.REACHED


def test_an_order_to_hold_that_was_requested_before_the_last_stop_is_refused(start_rig: Start) -> None:
    rig = start_rig(start_enabled=False)
    rig.supervisor.handle(Stop(epoch=7))
    for number, order in ((100, Order.ENABLE), (101, Order.RESET_FAULT)):
        rig.supervisor.handle(Command(number, order, epoch=6))
        answer = rig.answer(number)
        assert not answer.done, order
        assert "a stop came after it was requested" in answer.message, order
        assert rig.mode is Mode.RELAXED
    # An emergency stop begins an epoch as well.
    rig.supervisor.handle(Command(102, Order.EMERGENCY_STOP, epoch=9))
    rig.wait(102)
    rig.supervisor.handle(Command(103, Order.RESET_FAULT, epoch=8))
    assert not rig.answer(103).done
    assert rig.mode is Mode.FAULT


def test_servos_that_another_driver_has_shifted_are_driven_by_a_calibration_that_knows_their_offsets() -> None:
    servos = SteppedEmulator("--population", "ros2_driver", wire_time=False)
    calibration = recalibrated(CALIBRATION, POPULATIONS["ros2_driver"])
    robot = within_calibration(so101(), calibration)
    rig = ArmRig(servos, robot=robot, hardware=SerialConfig(calibration, "/dev/arm")).started()
    rig.execute(PAN)
    rig.until(lambda: bool(rig.ended))
    assert rig.outcomes == [Outcome.REACHED]
