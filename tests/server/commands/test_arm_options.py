from __future__ import annotations

import argparse

import pytest

from robot.calibration import Calibration, save
from robot.errors import CalibrationError, PortBusy, PortNotFound
from server.commands.arm_options import add_calibration, add_serial, guarded, read_calibration
from server.commands.terminal import ExitCode


def parsed(*arguments):
    parser = argparse.ArgumentParser()
    add_serial(parser)
    add_calibration(parser)
    return parser.parse_args(arguments)


def test_without_options_the_adapter_is_looked_for_and_no_calibration_read():
    options = parsed()
    assert options.serial == "auto"
    assert read_calibration(options) is None


def test_a_calibration_is_read_from_its_file(tmp_path):
    save(Calibration.nominal(), tmp_path / "arm.json")
    assert read_calibration(parsed("--calibration", str(tmp_path / "arm.json"))) == Calibration.nominal()


def test_a_calibration_of_unknown_id_is_refused():
    with pytest.raises(CalibrationError):
        read_calibration(parsed("--calibration", "nobodys"))


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PortNotFound("/dev/x"), "does not exist"),
        (PortBusy("/dev/x"), "armbridge serve"),
        (KeyboardInterrupt(), "stop"),
    ],
)
def test_what_a_command_fails_at_is_one_line_and_exit_1(error, words, capsys):
    def command(_terminal):
        raise error

    assert guarded(command) is ExitCode.FAILED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said


def test_a_mistake_in_a_command_is_not_hidden():
    def command(_terminal):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        guarded(command)
