"""lerobot's driver on a serial port: each line of the input names a step, each line of the output is its result."""

import json
import sys

from lerobot.motors import Motor, MotorCalibration, MotorNormMode
from lerobot.motors.feetech import FeetechMotorsBus

port, joints = sys.argv[1], sys.argv[2:]
motors = {joint: Motor(number, "sts3215", MotorNormMode.DEGREES) for number, joint in enumerate(joints, 1)}
bus = FeetechMotorsBus(port, motors)


def positions_deg() -> dict[str, float]:
    """Connect as lerobot's robots do, and read all positions by lerobot's own calibration."""
    bus.disconnect(disable_torque=False)
    bus.connect()
    ranges = {joint: MotorCalibration(motor.id, 0, 0, 0, 4095) for joint, motor in motors.items()}
    bus.write_calibration(ranges)
    return dict(bus.sync_read("Present_Position"))


for line in sys.stdin:
    step, *names = line.split()
    try:
        result = positions_deg() if step == "positions" else bus.setup_motor(*names)
    except Exception as error:
        result = f"{type(error).__name__}: {error}"
    print(json.dumps(result), flush=True)
