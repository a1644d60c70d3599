"""A new kit: six servos as the factory makes them, of which any may be plugged in."""

from robot.commissioning.setup import ServoLine
from robot.emulator.feetech import FeetechServo
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import SETTINGS, Register
from tests.helpers.emulator import SteppedEmulator

# Options of the emulator of a kit.
KIT = ("--population", "kit")


def set_registers(servo: FeetechServo, values: dict[Register, int]) -> None:
    """Set registers of an emulated servo, stored as by another program."""
    servo.write(Register.LOCK, Register.LOCK.encode(0))
    for register, value in values.items():
        servo.write(register, register.encode(value))
    if Register.LOCK not in values:
        servo.write(Register.LOCK, Register.LOCK.encode(1))


class Kit:
    """Servos of an emulator with the options :data:`KIT`, in the order of the chain; none is plugged in at first."""

    def __init__(self, emulator: SteppedEmulator) -> None:
        self.emulator = emulator
        self.servos = emulator.servo_bus.servos
        self.plug()

    def plug(self, *places: int) -> None:
        """Have the servos at these places of the chain on the wire, from 0 on, and no others."""
        joints = [servo.joint for servo in self.servos]
        plugged = [joints[place] for place in places]
        self.emulator.command(unplug=[joint for joint in joints if joint not in plugged], plug=plugged)

    def line(self) -> ServoLine:
        """Return the servos' port, in the emulator's time."""
        return ServoLine(self.open, self.emulator.run)

    def open(self, baudrate: int) -> Bus:
        """Open the bus at a baud rate."""
        self.emulator.port.baudrate = baudrate
        return self.emulator.open_bus()

    def held(self, place: int) -> dict[Register, int]:
        """Return the settings of a servo."""
        return {register: self.servos[place].value(register) for register in SETTINGS}
