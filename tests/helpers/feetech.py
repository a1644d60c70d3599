"""Hardware on emulated servos of Feetech, in the test's own process and time."""

import numpy as np

from robot.hardware.feetech.family import Feetech
from robot.hardware.interface import Measured, run_to_end
from robot.hardware.servos.hardware import ServoHardware
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION
from tests.helpers.emulator import SteppedEmulator


class FeetechsInUse:
    """Hardware on emulated servos of Feetech, found and read once."""

    def __init__(self, emulator: SteppedEmulator | None = None) -> None:
        self.emulator = emulator or SteppedEmulator()
        self.hardware = unread_hardware(self.emulator)
        self.found = run_to_end(self.hardware.survey())
        self.read()

    def read(self, after_s: float = 0.01) -> Measured:
        self.emulator.run(after_s)
        measured = self.hardware.read()
        assert measured is not None
        return measured

    def enable(self) -> np.ndarray:
        """Bring all joints to hold; returns their goals."""
        return run_to_end(self.hardware.enable(range(6)), self.emulator.run)


def unread_hardware(emulator: SteppedEmulator) -> ServoHardware:
    """Hardware that was neither found nor read."""
    return ServoHardware(Feetech(), emulator.open_bus(), CALIBRATION, BOUNDS, GuardLimits(), emulator.clock)
