"""Emulated Dynamixel bus: instruction packets of protocol 2.0 parsed, status packets built.

Packets are those of ROBOTIS's e-manual, DYNAMIXEL Protocol 2.0, byte for byte. PING, READ, WRITE, REBOOT, SYNC_READ and
SYNC_WRITE are carried out; every other instruction is answered with an instruction error. Replies take no time on the
wire.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from dynamixel_sdk import (
    BROADCAST_ID,
    INST_PING,
    INST_READ,
    INST_REBOOT,
    INST_STATUS,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
)

from robot.emulator.dynamixel.servo import REBOOT_S, DynamixelServo
from robot.emulator.faults import Faults
from robot.hardware.dynamixel.packets import HEADER, PREFIX_BYTES, crc16, packet
from robot.hardware.dynamixel.registers import Register

INSTRUCTION_ERROR = 2
CRC_ERROR = 3

# Register STATUS_RETURN_LEVEL: from which value a servo answers these instructions; a ping it always answers.
_ANSWERED_FROM: Mapping[int, int] = {INST_PING: 0, INST_READ: 1, INST_SYNC_READ: 1}
_OTHERS_ANSWERED_FROM = 2

# A packet that is incomplete for so long was cut off, and is dropped so that it does not swallow the next one.
PARTIAL_PACKET_S = 0.005

# INST and CRC.
_SHORTEST_LENGTH = 3

_HEADER_IN_BODY = b"\xff\xff\xfd"


@dataclass(frozen=True)
class Instruction:
    """Instruction packet.

    Attributes:
        servo_id: id of its receiver, or the broadcast.
        code: number of the instruction.
        parameters: bytes behind it, without stuffing.
        sound: False if its CRC is wrong.
    """

    servo_id: int
    code: int
    parameters: bytes
    sound: bool = True


class DynamixelBus:
    """Servos of an arm on one wire.

    Args:
        servos: in the order of their ids.
        faults: faults of the bus, which may be changed while it runs.
        now_s: monotonic time [s].
        weigh: loads the servos with the links' weight at the present pose; None for an arm without weight.

    Attributes:
        servos: as given.
        faults: as given.
    """

    def __init__(
        self,
        servos: Sequence[DynamixelServo],
        faults: Faults,
        now_s: float,
        weigh: Callable[[], None] | None = None,
    ) -> None:
        self.servos = tuple(servos)
        self.faults = faults
        self._weigh = weigh or (lambda: None)
        self._weigh()
        self._now_s = now_s
        self._parser = InstructionParser()

    def advance(self, now_s: float) -> None:
        """Advance the servos to the monotonic time ``now_s`` [s]."""
        if now_s <= self._now_s:
            return
        for servo in self.servos:
            servo.step(now_s - self._now_s)
        self._now_s = now_s
        if not all(servo.plant.at_rest for servo in self.servos):
            self._weigh()

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes from the host.

        Args:
            data: bytes from the host.
            now_s: monotonic time [s].

        Returns:
            Replies to the instructions that they complete.
        """
        self.advance(now_s)
        replies = b""
        for instruction in self._parser.feed(data, now_s):
            if not self.faults.loses_instruction():
                replies += self._carry_out(instruction)
        return replies

    def _carry_out(self, instruction: Instruction) -> bytes:
        present = {
            servo.servo_id: servo
            for servo in self.servos
            if servo.answers and servo.servo_id not in self.faults.offline
        }
        if instruction.sound:
            for servo in present.values():
                servo.hear()
        if instruction.sound and instruction.code == INST_SYNC_READ:
            return self._sync_read(present, instruction.parameters)
        if instruction.sound and instruction.code == INST_SYNC_WRITE:
            _sync_write(present, instruction.parameters)
            return b""
        if instruction.servo_id != BROADCAST_ID:
            servos = [present[instruction.servo_id]] if instruction.servo_id in present else []
        else:
            servos = sorted(present.values(), key=lambda servo: servo.servo_id)
        # A broadcast is answered by nobody, except a ping (e-manual, Packet ID).
        silent = instruction.servo_id == BROADCAST_ID and instruction.code != INST_PING
        replies = b""
        for servo in servos:
            # A reboot resets the level of what it answers.
            level = servo.value(Register.STATUS_RETURN_LEVEL)
            reply = self._reply(servo, *_execute(servo, instruction))
            if not silent and level >= _ANSWERED_FROM.get(instruction.code, _OTHERS_ANSWERED_FROM):
                replies += reply
        return replies

    def _sync_read(self, present: Mapping[int, DynamixelServo], parameters: bytes) -> bytes:
        address, length = _block(parameters)
        replies = b""
        for servo_id in parameters[4:]:
            servo = present.get(servo_id)
            if servo is not None:
                replies += self._reply(servo, 0, servo.read(address, length))
            elif self.faults.stall_behind_missing:
                break
        return replies

    def _reply(self, servo: DynamixelServo, error: int, data: bytes) -> bytes:
        return self.faults.apply(status_packet(servo.servo_id, servo.error | error, data))


class InstructionParser:
    """Parser of the host's bytes; what is no packet is skipped."""

    def __init__(self) -> None:
        self._buffer = b""
        self._last_byte_s = 0.0

    def feed(self, data: bytes, now_s: float) -> list[Instruction]:
        """Return the instructions completed by ``data``."""
        if now_s - self._last_byte_s > PARTIAL_PACKET_S:
            self._buffer = b""
        self._last_byte_s = now_s
        self._buffer += data
        instructions = []
        at = self._buffer.find(HEADER)
        while 0 <= at <= len(self._buffer) - PREFIX_BYTES:
            length_at = at + PREFIX_BYTES - 2
            length = int.from_bytes(self._buffer[length_at : length_at + 2], "little")
            end = at + PREFIX_BYTES + length
            if end > len(self._buffer):
                break
            if length >= _SHORTEST_LENGTH:
                instructions.append(_instruction(self._buffer[at:end]))
            at = self._buffer.find(HEADER, end)
        self._buffer = self._buffer[at:] if at >= 0 else self._buffer[-len(HEADER) + 1 :]
        return instructions


# An arm at rest repeats its replies, a moving one those to writes.
@lru_cache(maxsize=64)
def status_packet(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """Build a servo's reply."""
    return packet(servo_id, INST_STATUS, bytes([error]) + data)


def _instruction(whole: bytes) -> Instruction:
    body = whole[PREFIX_BYTES:-2].replace(_HEADER_IN_BODY + b"\xfd", _HEADER_IN_BODY)
    sound = crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little")
    return Instruction(whole[len(HEADER)], body[0], body[1:], sound)


def _execute(servo: DynamixelServo, instruction: Instruction) -> tuple[int, bytes]:
    """Carry out an instruction on one servo; return the number of the error, 0 for none, and the data of its reply."""
    if not instruction.sound:
        return CRC_ERROR, b""
    parameters = instruction.parameters
    match instruction.code, len(parameters):
        case (code, 0) if code == INST_PING:
            model, firmware = servo.value(Register.MODEL_NUMBER), servo.value(Register.FIRMWARE_VERSION)
            return 0, model.to_bytes(2, "little") + bytes([firmware])
        case (code, 4) if code == INST_READ:
            return 0, servo.read(*_block(parameters))
        case (code, count) if code == INST_WRITE and count > 2:
            return servo.write(int.from_bytes(parameters[:2], "little"), parameters[2:]), b""
        case (code, 0) if code == INST_REBOOT:
            servo.power_up(REBOOT_S)
            return 0, b""
    return INSTRUCTION_ERROR, b""


def _block(parameters: bytes) -> tuple[int, int]:
    """Return the address and length of a block of registers."""
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")


def _sync_write(present: Mapping[int, DynamixelServo], parameters: bytes) -> None:
    address, length = _block(parameters)
    blocks = parameters[4:]
    for at in range(0, len(blocks) - length, length + 1):
        servo = present.get(blocks[at])
        if servo is not None:
            servo.write(address, blocks[at + 1 : at + 1 + length])
