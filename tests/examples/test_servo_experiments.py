"""Experiments on the servos, on emulated ones: each has a finding, and leaves the servos as it found them."""

import contextlib

import pytest

from examples.servo_experiments import EXPERIMENTS, GENTLE_TORQUE, STEP_TICKS, ServoRig, run_experiment
from harness.emulator import RunningEmulator
from harness.server import read_write_log
from robot.commissioning.doctor import Verdict
from robot.errors import StartupError
from robot.hardware.feetech.registers import Register

IDS = (1, 2, 3, 4, 5, 6)
GRIPPER = 6
BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}


def rig_on(emulator, bus):
    return ServoRig(bus, GRIPPER, IDS, emulator.clock, emulator.run)


@pytest.fixture
def rig(bus, emulator):
    return rig_on(emulator, bus)


def answer(name, rig):
    return run_experiment(BY_NAME[name], rig)


FOUND = {
    "return delay register": "it works",
    "goal register and torque": "torque off keeps the goal; torque on drives to a goal set before",
    "lag of the position loop": "ticks is followed within",
    "sync read past a missing servo": "those behind it answer",
}


@pytest.mark.parametrize("name", [each.name for each in EXPERIMENTS if not each.needs_hands])
def test_every_experiment_has_a_finding_and_leaves_the_servos_as_it_found_them(rig, name):
    def control():
        return [
            rig.bus.read(servo_id, register)
            for servo_id in IDS
            for register in (Register.TORQUE_ENABLE, Register.TORQUE_LIMIT, Register.RETURN_DELAY, Register.LOCK)
        ]

    before = control()
    finding = answer(name, rig)
    assert finding.check == name
    assert FOUND.get(name, "") in finding.says
    assert control() == before


def test_no_experiment_stores_anything_or_switches_torque_on_far_from_the_goal(start_emulator, write_log):
    emulator = start_emulator("--write-log", str(write_log))
    rig = rig_on(emulator, emulator.open_bus())
    for experiment in EXPERIMENTS:
        if not experiment.needs_hands:
            run_experiment(experiment, rig)
    entries = read_write_log(write_log)
    assert {servo for entry in entries for servo in entry["data"]} == {str(GRIPPER)}
    assert not [entry for entry in entries if entry["address"] == Register.LOCK and entry["data"]["6"] == [0]]
    goals = [e["data"]["6"][1] + 256 * e["data"]["6"][2] for e in entries if e["address"] == Register.ACCELERATION]
    assert max(goals) - min(goals) <= 30


def test_an_arm_that_holds_is_not_touched(rig):
    rig.bus.write(GRIPPER, Register.TORQUE_ENABLE, 1)
    finding = answer("lag of the position loop", rig)
    assert finding.verdict is Verdict.OPEN
    assert "relax the arm first" in finding.says
    assert rig.bus.read(GRIPPER, Register.TORQUE_ENABLE) == 1


def test_a_bus_that_stalls_behind_a_missing_servo_is_found_out(rig, emulator):
    emulator.command(stall_behind_missing=True)
    assert "servos 2, 3, 4, 5, 6 did not answer" in answer("sync read past a missing servo", rig).says


def test_an_overload_that_stays_is_found_out_and_without_one_the_question_is_open(rig, emulator):
    assert answer("overload cleared by torque off and on", rig).verdict is Verdict.OPEN
    emulator.command(status={"3": 32})
    assert rig.bus.read(3, Register.STATUS)
    assert answer("overload cleared by torque off and on", rig).says == "it does not"


@pytest.mark.parametrize(("holding", "says"), [(False, "off"), (True, "servos 2 power up with torque on")])
def test_torque_at_power_up_is_read_after_a_power_cut(rig, emulator, holding, says):
    if holding:
        emulator.command(powers_up_holding=[2])
    emulator.command_later(5.0, offline=list(IDS))
    emulator.command_later(7.0, power_cycle=list(IDS), online=list(IDS))
    assert answer("torque at power-up", rig).says == says


def test_without_a_power_cut_the_finding_is_open(rig):
    finding = answer("torque at power-up", rig)
    assert (finding.verdict, finding.says) == (Verdict.OPEN, "the power was not cut within 60 s")


def test_a_servo_that_falls_silent_leaves_the_question_open(rig, emulator):
    emulator.command(offline=[GRIPPER])
    assert answer("damping (torque 2)", rig).verdict is Verdict.OPEN


def test_torque_is_on_gently_where_the_servo_stands_and_off_afterwards_also_after_ctrl_c(rig):
    with contextlib.suppress(KeyboardInterrupt), rig.holding() as goal:
        assert rig.read(Register.TORQUE_ENABLE) == 1
        assert rig.read(Register.TORQUE_LIMIT) == GENTLE_TORQUE
        assert abs(rig.telemetry().position_ticks - goal) <= 2
        raise KeyboardInterrupt
    assert rig.read(Register.TORQUE_ENABLE) == 0
    assert rig.read(Register.TORQUE_LIMIT) == 1000


def test_torque_does_not_come_on_far_from_the_goal_or_outside_the_angle_limits(rig):
    far = rig.telemetry().position_ticks + STEP_TICKS + 10
    with pytest.raises(StartupError, match="was moved"), rig.holding(far):
        pass
    assert rig.read(Register.TORQUE_ENABLE) == 0
    rig.set(Register.MIN_ANGLE_LIMIT, rig.telemetry().position_ticks + 100)
    with pytest.raises(StartupError, match="outside its angle limits"), rig.holding():
        pass
    assert rig.read(Register.TORQUE_ENABLE) == 0


def test_the_program_prints_the_finding_of_each_experiment_that_it_may_do(run_example):
    emulator = RunningEmulator()
    try:
        answer = run_example("servo_experiments.py", "--serial", emulator.port, "--yes")
    finally:
        emulator.end()
    assert answer.returncode == 0, answer.stderr
    done = [line.partition(":")[0] for line in answer.stdout.splitlines()]
    assert done == [experiment.name for experiment in EXPERIMENTS if not experiment.needs_hands]
