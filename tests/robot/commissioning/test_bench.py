from __future__ import annotations

import pytest

from robot.commissioning.experiments import GENTLE_TORQUE, POWER_TIMEOUT_S, STEP_S, STEP_TICKS, ServoRig
from robot.errors import StartupError
from robot.hardware.feetech.registers import Register

GRIPPER = 6


@pytest.fixture
def rig(bus, emulator):
    return ServoRig(bus, GRIPPER, (1, 2, 3, 4, 5, 6), emulator.clock, emulator.run)


def test_torque_is_on_gently_where_the_servo_stands_and_off_afterwards(rig):
    with rig.holding() as goal:
        assert rig.read(Register.TORQUE_ENABLE) == 1
        assert rig.read(Register.TORQUE_LIMIT) == GENTLE_TORQUE
        assert abs(rig.telemetry().position_ticks - goal) <= 2
    assert rig.read(Register.TORQUE_ENABLE) == 0
    assert rig.read(Register.TORQUE_LIMIT) == 1000


def test_torque_is_off_after_a_mistake_and_after_ctrl_c(rig):
    with pytest.raises(KeyboardInterrupt), rig.holding():
        raise KeyboardInterrupt
    assert rig.read(Register.TORQUE_ENABLE) == 0


def test_torque_does_not_come_on_far_from_the_goal(rig):
    far = rig.telemetry().position_ticks + STEP_TICKS + 10
    with pytest.raises(StartupError, match="was moved"), rig.holding(far):
        pass
    assert rig.read(Register.TORQUE_ENABLE) == 0


def test_torque_does_not_come_on_outside_the_angle_limits(rig):
    rig.set(Register.MIN_ANGLE_LIMIT, rig.telemetry().position_ticks + 100)
    with pytest.raises(StartupError, match="outside its angle limits"), rig.holding():
        pass
    assert rig.read(Register.TORQUE_ENABLE) == 0


def test_a_step_goes_towards_the_middle_and_is_followed(rig):
    with rig.holding() as start:
        goal = rig.one_step_from(start)
        samples = rig.go(goal)
    assert goal - start == STEP_TICKS
    assert abs(samples[-1][1].position_ticks - goal) <= 3


def test_a_step_is_sampled_for_as_long_as_it_may_take(rig):
    with rig.holding() as start:
        times_s = [at_s for at_s, _ in rig.go(rig.one_step_from(start))]
    assert times_s == sorted(times_s)
    assert 0.9 * STEP_S < times_s[-1] < STEP_S


def test_waiting_for_a_servo_ends_when_it_answers_or_in_time(rig, emulator):
    started_s = emulator.clock()
    assert rig.await_answers(answering=True)
    assert emulator.clock() - started_s < 0.01
    assert not rig.await_answers(answering=False)
    assert emulator.clock() - started_s == pytest.approx(POWER_TIMEOUT_S, abs=0.2)
    emulator.command_later(1.0, offline=[GRIPPER])
    assert rig.await_answers(answering=False)
    assert emulator.clock() - started_s == pytest.approx(POWER_TIMEOUT_S + 1.0, abs=0.4)
