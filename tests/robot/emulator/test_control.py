from __future__ import annotations

import json
import re

import pytest

from robot.calibration import Calibration
from robot.emulator.__main__ import build_servos
from robot.emulator.control import answer
from robot.emulator.wire import Faults, ServoBus
from robot.registers import Register


@pytest.fixture
def bus():
    return ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(), 0.0)


def test_every_command_is_carried_out_and_acknowledged(bus):
    assert json.loads(answer(b'{"drop": 0.25, "corrupt": 1, "offline": [3, 4]}', bus)) == {"ok": True}
    assert (bus.faults.drop, bus.faults.corrupt, bus.faults.offline) == (0.25, 1.0, {3, 4})
    assert json.loads(answer(b'{"online": [3]}', bus)) == {"ok": True}
    assert bus.faults.offline == {4}


def test_a_power_cycle_switches_torque_off_on_the_servos_named(bus):
    for servo in bus.servos:
        servo.write(Register.TORQUE_ENABLE, bytes([1]))
    answer(b'{"power_cycle": [2]}', bus)
    assert [servo.value(Register.TORQUE_ENABLE) for servo in bus.servos] == [1, 0, 1, 1, 1, 1]


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
        (b'{"offline": [7]}', r"out of \[1, 2, 3, 4, 5, 6\]"),
        (b'{"offline": 3}', "list of servo ids"),
        (b'{"online": [[]]}', "list of servo ids"),
    ],
)
def test_what_makes_no_sense_is_answered_with_the_reason(bus, line, reason):
    reply = answer(line, bus)
    assert reply.endswith(b"\n")
    assert re.search(reason, json.loads(reply)["error"])


def test_no_part_of_a_refused_command_is_carried_out(bus):
    assert "error" in json.loads(answer(b'{"drop": 0.5, "offline": [9]}', bus))
    assert bus.faults.drop == 0.0
