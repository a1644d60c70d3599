from __future__ import annotations

import contextlib
import json
import time

import pytest

from robot.emulator.feetech import build_servos
from robot.emulator.servo_bus import WriteLog
from robot.hardware.feetech.registers import goal_block
from tests.helpers.robots import nominal_calibration


def lines_of(path, record):
    log = WriteLog(path)
    record(log)
    lines = [json.loads(line) for line in path.read_text().splitlines()]  # not closed: a killed process leaves all
    log.close()
    return lines


def test_a_line_has_the_write_and_the_state_of_every_servo(tmp_path):
    servos = build_servos(nominal_calibration(), [0.0] * 6)
    servos[1].write(40, b"\x01")
    before_s = time.monotonic()
    (line,) = lines_of(tmp_path / "log", lambda log: log.record_write(12.5, 3, 40, {2: b"\x01"}, servos))
    assert before_s <= line.pop("machine_t") <= time.monotonic()
    assert line == {
        "t": 12.5,
        "instruction": "write",
        "address": 40,
        "data": {"2": [1]},
        "registers": {"2": {"TORQUE_ENABLE": 1}},
        "present": {str(servo.servo_id): servo.present_ticks for servo in servos},
        "torque": {"1": 0, "2": 1, "3": 0, "4": 0, "5": 0, "6": 0},
        "goal": {str(i): 0 for i in range(1, 7)},
        "limit": {str(i): 1000 for i in range(1, 7)},
        "status": {str(i): 0 for i in range(1, 7)},
    }


def test_the_registers_wholly_written_are_named_and_decoded(tmp_path):
    block, servos = goal_block(-5, 700), build_servos(nominal_calibration(), [0.0] * 6)
    data = {3: block, 4: block[:2]}
    (line,) = lines_of(tmp_path / "log", lambda log: log.record_write(0.0, 0x83, 41, data, servos))
    assert line["registers"] == {
        "3": {"ACCELERATION": 254, "GOAL_POSITION": -5, "GOAL_TIME": 0, "GOAL_VELOCITY": 700},
        "4": {"ACCELERATION": 254},
    }


@pytest.mark.parametrize(("append", "commands"), [(False, [{"new": 1}]), (True, [{"old": 1}, {"new": 1}])])
def test_a_log_that_is_there_is_replaced_or_gone_on_with(tmp_path, append, commands):
    path = tmp_path / "log"
    for command, appends in (({"old": 1}, False), ({"new": 1}, append)):
        with contextlib.closing(WriteLog(path, append=appends)) as log:
            log.record_command(0.0, command, [])
    assert [json.loads(line)["command"] for line in path.read_text().splitlines()] == commands
