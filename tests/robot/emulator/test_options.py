from __future__ import annotations

import argparse
import contextlib
import json

import pytest

from robot.emulator.faults import PROBABILITIES
from robot.emulator.options import add_options, build
from robot.servos.registers import Register


def parser():
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser


@contextlib.contextmanager
def built(*arguments):
    with contextlib.ExitStack() as resources:
        yield build(parser().parse_args(arguments), resources)


def test_without_options_there_is_an_arm_without_faults():
    with built() as emulation:
        assert [servo.servo_id for servo in emulation.bus.servos] == [1, 2, 3, 4, 5, 6]
        assert all(getattr(emulation.bus.faults, name) == 0.0 for name in PROBABILITIES)
        assert {servo.plant.gravity_permille != 0.0 for servo in emulation.bus.servos[1:4]} == {True}


@pytest.mark.parametrize("name", PROBABILITIES)
def test_every_fault_that_strikes_by_chance_is_an_option(name):
    with built("--" + name.replace("_", "-"), "0.25") as emulation:
        assert getattr(emulation.bus.faults, name) == 0.25


def test_the_servos_are_of_the_kind_asked_for():
    with built("--supply", "4.8", "--heat-rate", "9", "--overload-latches", "--powers-up-holding") as emulation:
        for servo in emulation.bus.servos:
            assert (servo.voltage_v, servo.motor.rate, servo.protection.latches) == (4.8, 9.0, True)
            assert servo.value(Register.TORQUE_ENABLE) == 1
            assert servo.value(Register.GOAL_POSITION) == servo.present_ticks


def test_bus_and_adapter_are_as_asked_for(tmp_path):
    link, log = tmp_path / "arm", tmp_path / "log"
    arguments = ["--usb-frame-ms", "1", "--stall-behind-missing", "--delay-s", "0.1", "--link", str(link)]
    with built(*arguments, "--write-log", str(log)) as emulation:
        assert emulation.adapter.frame_s == 0.001
        assert emulation.bus.faults.stall_behind_missing
        assert emulation.bus.faults.delay_s == 0.1
        assert str(link.readlink()) == emulation.adapter.port
        emulation.bus.record_command({})
    assert json.loads(log.read_text())["command"] == {}
    assert not link.is_symlink()


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
