from __future__ import annotations

import json

from robot.calibration import Calibration
from robot.emulator.__main__ import build_servos
from robot.emulator.write_log import WriteLog


def test_a_line_tells_the_write_and_where_every_servo_stood(tmp_path):
    servos = build_servos(Calibration.nominal(), [0.0] * 6)
    path = tmp_path / "writes.jsonl"
    log = WriteLog(path)
    servos[1].write(40, b"\x01")
    log.record(12.5, "write", 40, {2: b"\x01"}, servos)
    (line,) = map(json.loads, path.read_text().splitlines())  # before it is closed: a killed process leaves all lines
    log.close()
    assert line == {
        "t": 12.5,
        "instruction": "write",
        "address": 40,
        "data": {"2": [1]},
        "present": {str(servo.servo_id): servo.present_ticks for servo in servos},
        "torque": {"1": 0, "2": 1, "3": 0, "4": 0, "5": 0, "6": 0},
    }
