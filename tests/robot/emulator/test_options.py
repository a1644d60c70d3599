from __future__ import annotations

import argparse
import contextlib
import json

import pytest

from robot.emulator.faults import PROBABILITIES
from robot.emulator.options import add_options, build_bus
from robot.hardware.feetech.registers import Register


def parser():
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser


@contextlib.contextmanager
def built(*arguments):
    with contextlib.ExitStack() as resources:
        yield build_bus(parser().parse_args(arguments), resources, 0.0)


def test_without_options_there_is_an_arm_without_faults():
    with built() as bus:
        assert [servo.servo_id for servo in bus.servos] == [1, 2, 3, 4, 5, 6]
        assert all(getattr(bus.faults, name) == 0.0 for name in PROBABILITIES)
        assert {servo.plant.gravity_permille != 0.0 for servo in bus.servos[1:4]} == {True}


@pytest.mark.parametrize("name", PROBABILITIES)
def test_every_fault_that_strikes_by_chance_is_an_option(name):
    with built("--" + name.replace("_", "-"), "0.25") as bus:
        assert getattr(bus.faults, name) == 0.25


def test_the_servos_are_of_the_kind_asked_for():
    with built("--supply", "4.8", "--heat-rate", "9", "--overload-latches", "--powers-up-holding") as bus:
        for servo in bus.servos:
            assert (servo.voltage_v, servo.motor.rate, servo.protection.latches) == (4.8, 9.0, True)
            assert servo.value(Register.TORQUE_ENABLE) == 1
            assert servo.value(Register.GOAL_POSITION) == servo.present_ticks


def test_the_bus_is_as_asked_for(tmp_path):
    log = tmp_path / "log"
    with built("--stall-behind-missing", "--delay-s", "0.1", "--write-log", str(log)) as bus:
        assert bus.faults.stall_behind_missing
        assert bus.faults.delay_s == 0.1
        bus.record_command({})
    assert json.loads(log.read_text())["command"] == {}


def test_bytes_take_their_time_on_the_wire_unless_that_is_not_wanted():
    options, ping = parser().parse_args([]), bytes([0xFF, 0xFF, 1, 2, 1, 0xFB])
    due_s = []
    with contextlib.ExitStack() as resources:
        for wire_time in (True, False):
            (reply,) = build_bus(options, resources, 0.0, wire_time=wire_time).receive(ping, 1.0)
            due_s.append(reply.due_s)
    assert due_s[0] > due_s[1] == 1.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--start=a"], "not a list of numbers"),
        (["--drop", "2"], "not a probability"),
        (["--supply", "nan"], "not a number from 0 to 25.5"),
        (["--heat-rate=-1"], "not a number from 0 to 3600"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_sentence(capsys, arguments, sentence):
    with pytest.raises(SystemExit):
        parser().parse_args(arguments)
    assert sentence in capsys.readouterr().err
