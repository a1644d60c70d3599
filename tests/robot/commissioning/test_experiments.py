from __future__ import annotations

import pytest

from robot.commissioning.doctor import Verdict
from robot.commissioning.experiments import EXPERIMENTS, Bench, ask
from robot.hardware.feetech.registers import Register
from tests.helpers.server import read_write_log

IDS = (1, 2, 3, 4, 5, 6)
GRIPPER = 6
BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}


def bench_on(emulator, bus):
    return Bench(bus, GRIPPER, IDS, emulator.clock, emulator.run)


@pytest.fixture
def bench(bus, emulator):
    return bench_on(emulator, bus)


def answer(name, bench):
    return ask(BY_NAME[name], bench)


@pytest.mark.parametrize("name", [each.name for each in EXPERIMENTS if not each.needs_hands])
def test_every_experiment_leaves_the_servos_as_it_found_them(bench, name):
    def control():
        return [
            bench.bus.read(servo_id, register)
            for servo_id in IDS
            for register in (Register.TORQUE_ENABLE, Register.TORQUE_LIMIT, Register.RETURN_DELAY, Register.LOCK)
        ]

    before = control()
    finding = answer(name, bench)
    assert finding.check == name
    assert control() == before


def test_no_experiment_stores_anything_or_switches_torque_on_far_from_the_goal(start_emulator, write_log):
    emulator = start_emulator("--write-log", str(write_log))
    bench = bench_on(emulator, emulator.open_bus())
    for experiment in EXPERIMENTS:
        if not experiment.needs_hands:
            ask(experiment, bench)
    entries = read_write_log(write_log)
    assert {servo for entry in entries for servo in entry["data"]} == {str(GRIPPER)}
    assert not [entry for entry in entries if entry["address"] == Register.LOCK and entry["data"]["6"] == [0]]
    goals = [e["data"]["6"][1] + 256 * e["data"]["6"][2] for e in entries if e["address"] == Register.ACCELERATION]
    assert max(goals) - min(goals) <= 30


def test_an_arm_that_holds_is_not_touched(bench):
    bench.bus.write(GRIPPER, Register.TORQUE_ENABLE, 1)
    finding = answer("lag of the position loop", bench)
    assert finding.verdict is Verdict.OPEN
    assert "relax the arm first" in finding.says
    assert bench.bus.read(GRIPPER, Register.TORQUE_ENABLE) == 1


def test_a_bus_that_stalls_behind_a_missing_servo_is_found_out(bench, emulator):
    assert answer("sync read past a missing servo", bench).says == "those behind it answer"
    emulator.command(stall_behind_missing=True)
    assert "servos 2, 3, 4, 5, 6 did not answer" in answer("sync read past a missing servo", bench).says


def test_a_return_delay_that_works_is_measured(bench):
    assert "it works" in answer("return delay register", bench).says


def test_a_goal_register_that_survives_torque_off_is_found_out(bench):
    assert (
        "torque off keeps the goal; torque on drives to a goal set before"
        in answer("goal register and torque", bench).says
    )


def test_without_an_overloaded_servo_that_question_stays_open(bench):
    assert answer("overload cleared by torque off and on", bench).verdict is Verdict.OPEN


def test_an_overload_that_stays_is_found_out(bench, emulator):
    emulator.command(status={"3": 32})
    assert bench.bus.read(3, Register.STATUS)
    assert answer("overload cleared by torque off and on", bench).says == "it does not"


def test_the_lag_of_a_step_is_measured(bench):
    assert "ticks is followed within" in answer("lag of the position loop", bench).says


@pytest.mark.parametrize(("holding", "says"), [(False, "off"), (True, "servos 2 power up with torque on")])
def test_torque_at_power_up_is_read_after_a_power_cut(bench, emulator, holding, says):
    if holding:
        emulator.command(powers_up_holding=[2])
    emulator.command_later(5.0, offline=list(IDS))
    emulator.command_later(7.0, power_cycle=list(IDS), online=list(IDS))
    assert answer("torque at power-up", bench).says == says


def test_a_power_cut_that_nobody_makes_leaves_the_question_open(bench):
    finding = answer("torque at power-up", bench)
    assert (finding.verdict, finding.says) == (Verdict.OPEN, "the power was not cut within 60 s")


def test_a_servo_that_falls_silent_leaves_the_question_open(bench, emulator):
    emulator.command(offline=[GRIPPER])
    assert answer("damping (torque 2)", bench).verdict is Verdict.OPEN
