from __future__ import annotations

import json
import re

import pytest

from robot.calibration import Calibration
from robot.emulator import control
from robot.emulator.adapter import UsbAdapter
from robot.emulator.arm import build_servos
from robot.emulator.control import FOR_SERVOS, NUMBERS, SWITCHES, VALUES, Emulation, answer
from robot.emulator.faults import Faults
from robot.emulator.servo_bus import ServoBus
from robot.emulator.write_log import WriteLog


@pytest.fixture
def log_path(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def emulation(log_path):
    log, adapter = WriteLog(log_path), UsbAdapter()
    yield Emulation(ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(), 0.0, log), adapter)
    adapter.unplug()
    log.close()


def test_every_command_is_carried_out_and_acknowledged(emulation):
    faults = emulation.bus.faults
    assert json.loads(answer(b'{"drop": 0.25, "corrupt": 1, "offline": [3, 4]}', emulation)) == {"ok": True}
    assert (faults.drop, faults.corrupt, faults.offline) == (0.25, 1.0, {3, 4})
    assert json.loads(answer(b'{"online": [3]}', emulation)) == {"ok": True}
    assert faults.offline == {4}


def test_values_go_to_the_servos_named(emulation):
    assert json.loads(answer(b'{"push": {"2": 50, "3": -7}}', emulation)) == {"ok": True}
    assert [servo.plant.push_permille for servo in emulation.bus.servos] == [0, 50, -7, 0, 0, 0]


def test_null_ends_what_can_be_ended(emulation):
    plant = emulation.bus.servos[0].plant
    answer(b'{"hand": {"1": 2000}}', emulation)
    assert plant.hand_ticks == 2000
    answer(b'{"hand": {"1": null}}', emulation)
    assert plant.hand_ticks is None


def test_an_adapter_comes_and_goes_and_its_name_is_told(emulation):
    before = emulation.adapter.port
    assert json.loads(answer(b'{"plugged": false}', emulation)) == {"ok": True, "port": before}
    assert emulation.adapter.descriptors == []
    told = json.loads(answer(b'{"plugged": "renamed"}', emulation))
    assert told == {"ok": True, "port": emulation.adapter.port}
    assert told["port"] != before
    assert len(emulation.adapter.descriptors) == 1


def test_a_switch_goes_on_and_off(emulation):
    answer(b'{"frozen": true}', emulation)
    assert emulation.adapter.frozen
    answer(b'{"frozen": false}', emulation)
    assert not emulation.adapter.frozen


def test_a_command_is_put_on_record(emulation, log_path):
    answer(b'{"push": {"2": 50}}', emulation)
    answer(b'{"push": {"9": 50}}', emulation)
    (line,) = map(json.loads, log_path.read_text().splitlines())
    assert line["command"] == {"push": {"2": 50}}


@pytest.mark.parametrize("name", [*NUMBERS, *FOR_SERVOS, *VALUES, *SWITCHES, "plugged"])
def test_every_command_is_documented(name):
    assert f'``{{"{name}": ' in str(control.__doc__)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"{", "Expecting"),
        (b"\xff", "decode"),
        (b"[]", "JSON object"),
        (b'{"explode": 1}', "unknown command 'explode'"),
        (b'{"drop": 1.5}', "drop is a probability from 0 to 1, not 1.5"),
        (b'{"corrupt": NaN}', "probability"),
        (b'{"corrupt": "x"}', "probability"),
        (b'{"noise": true}', "probability"),
        (b'{"delay_s": 1' + b"0" * 400 + b"}", "delay_s is a number from 0 to 10"),
        (b'{"supply": -1}', "supply is a number from 0 to 25.5, not -1"),
        (b'{"offline": [7]}', r"out of \[1, 2, 3, 4, 5, 6\]"),
        (b'{"offline": 3}', "list of servo ids"),
        (b'{"online": [[]]}', "list of servo ids"),
        (b'{"hand": [3]}', "object with servo ids"),
        (b'{"hand": {"7": 2000}}', "object with servo ids"),
        (b'{"hand": {"1": 5000}}', "hand is a number from 0 to 4095, not 5000"),
        (b'{"push": {"1": null}}', "push is a number"),
        (b'{"frozen": 1}', "frozen is true or false"),
        (b'{"plugged": "elsewhere"}', "plugged is true, false or 'renamed'"),
    ],
)
def test_what_makes_no_sense_is_answered_with_the_reason(emulation, line, reason):
    reply = answer(line, emulation)
    assert reply.endswith(b"\n")
    assert re.search(reason, json.loads(reply)["error"])


def test_no_part_of_a_refused_command_is_carried_out(emulation):
    assert "error" in json.loads(answer(b'{"drop": 0.5, "offline": [9]}', emulation))
    assert emulation.bus.faults.drop == 0.0
