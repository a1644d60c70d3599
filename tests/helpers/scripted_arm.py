"""Six servos in fifty lines, byte by byte: a second opinion on the bus, which shares no model with the emulator."""

from __future__ import annotations

from scservo_sdk import BROADCAST_ID, INST_PING, INST_READ, INST_SYNC_READ, INST_SYNC_WRITE, INST_WRITE

from robot.calibration import Calibration
from robot.emulator.servo_bus import Instruction, status_packet

# Addresses and values of Feetech's memory table V3.6, as bytes: nothing here asks robot.hardware.feetech.registers.
MODEL, MIN_LIMIT, MAX_LIMIT, VOLTAGE_LIMITS, MAX_TORQUE = 3, 9, 11, 14, 16
TORQUE, GOAL, TORQUE_LIMIT, LOCK, PRESENT, VOLTAGE, TEMPERATURE = 40, 42, 48, 55, 56, 62, 63
MEMORY_BYTES = 128


class ScriptedServos:
    """A script for :class:`tests.robot.conftest.ScriptedPeer`: servos that are at their goal at once."""

    def __init__(self, calibration: Calibration) -> None:
        self.memory = {joint.servo_id: bytearray(MEMORY_BYTES) for joint in calibration.joints}
        for joint in calibration.joints:
            self._put(joint.servo_id, MODEL, 777)
            self._put(joint.servo_id, MIN_LIMIT, joint.range_min)
            self._put(joint.servo_id, MAX_LIMIT, joint.range_max)
            self._put(joint.servo_id, VOLTAGE_LIMITS, 80 | 40 << 8)
            self._put(joint.servo_id, MAX_TORQUE, 1000)
            self._put(joint.servo_id, TORQUE_LIMIT, 1000)
            self._put(joint.servo_id, LOCK, 1)
            self._put(joint.servo_id, PRESENT, joint.ticks_from_rad(0.1))
            self._put(joint.servo_id, VOLTAGE, 50)
            self._put(joint.servo_id, TEMPERATURE, 30)

    def __call__(self, instruction: Instruction) -> list[tuple[float, bytes]]:
        """Obey, and return the replies."""
        code, parameters, servo = instruction.code, bytes(instruction.parameters), instruction.servo_id
        if code == INST_SYNC_READ:
            address, length = parameters[:2]
            return [(0.0, self._reply(each, address, length)) for each in parameters[2:] if each in self.memory]
        if code == INST_SYNC_WRITE:
            address, length = parameters[:2]
            for at in range(2, len(parameters), length + 1):
                self._write(parameters[at], address, parameters[at + 1 : at + 1 + length])
            return []
        if code == INST_WRITE:
            for each in self.memory if servo == BROADCAST_ID else (servo,):
                self._write(each, parameters[0], parameters[1:])
        if servo not in self.memory or code not in (INST_PING, INST_READ, INST_WRITE):
            return []
        asked = parameters[:2] if code == INST_READ else b"\0\0"
        return [(0.0, self._reply(servo, asked[0], asked[1]))]

    def _reply(self, servo: int, address: int, length: int) -> bytes:
        return status_packet(servo, 0, bytes(self.memory[servo][address : address + length]))

    def _write(self, servo: int, address: int, data: bytes) -> None:
        memory = self.memory[servo]
        memory[address : address + len(data)] = data
        if memory[TORQUE] == 1:
            memory[PRESENT : PRESENT + 2] = memory[GOAL : GOAL + 2]

    def _put(self, servo: int, address: int, value: int) -> None:
        self.memory[servo][address : address + 2] = value.to_bytes(2, "little")
