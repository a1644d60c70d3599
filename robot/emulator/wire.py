"""The servos' side of the wire format: instructions cut out of the host's bytes, status packets built."""

from __future__ import annotations

from dataclasses import dataclass

from scservo_sdk import BROADCAST_ID

from robot.hardware.feetech.packets import HEADER, LENGTH_OVERHEAD, checksum

# A packet that stays unfinished this long was cut off, and does not swallow the next one.
PARTIAL_PACKET_S = 0.005

# Header, id, LEN and checksum.
_FRAME_BYTES = 5


@dataclass(frozen=True)
class Instruction:
    """A sound packet from the host."""

    servo_id: int
    code: int
    parameters: bytes

    @property
    def byte_count(self) -> int:
        """Bytes of the packet on the wire."""
        return len(self.parameters) + LENGTH_OVERHEAD + _FRAME_BYTES - 1


def status_packet(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """Build a servo's reply."""
    body = bytes([servo_id, len(data) + LENGTH_OVERHEAD, error]) + data
    return HEADER + body + bytes([checksum(body)])


class InstructionParser:
    """Cuts the host's bytes into instructions; what is not sound is skipped."""

    def __init__(self) -> None:
        self._buffer = b""
        self._last_byte_s = 0.0

    @property
    def begun(self) -> bool:
        """True while the bytes left over may be the beginning of an instruction."""
        return self._buffer.startswith(HEADER[:1])

    def feed(self, data: bytes, now_s: float) -> list[Instruction]:
        """Return the instructions completed by ``data``."""
        if now_s - self._last_byte_s > PARTIAL_PACKET_S:
            self._buffer = b""
        self._last_byte_s = now_s
        self._buffer += data
        instructions = []
        at = self._buffer.find(HEADER)
        while 0 <= at <= len(self._buffer) - _FRAME_BYTES:
            end = at + self._buffer[at + 3] + _FRAME_BYTES - 1
            if end > len(self._buffer) and self._buffer[at + 2] <= BROADCAST_ID:
                break
            instruction = self._instruction(at, end)
            if instruction is not None:
                instructions.append(instruction)
            at = self._buffer.find(HEADER, at + 1 if instruction is None else end)
        self._buffer = self._buffer[at:] if at >= 0 else self._buffer[-1:]
        return instructions

    def _instruction(self, at: int, end: int) -> Instruction | None:
        body = self._buffer[at + 2 : end - 1]
        if len(body) <= LENGTH_OVERHEAD or end > len(self._buffer) or self._buffer[end - 1] != checksum(body):
            return None
        return Instruction(servo_id=body[0], code=body[2], parameters=body[3:])
