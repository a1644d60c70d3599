"""Faults of the emulated bus, random or on command."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

# Longer than the host waits for a reply: a delayed one arrives after the next instruction.
DELAY_S = 0.02

MAX_NOISE_BYTES = 8

# Ids that a servo can have.
SERVO_IDS = range(0xFD)


@dataclass
class Faults:
    """Probabilities of faults, and servos off the bus; may be changed while the bus runs."""

    drop: float = 0.0  # probability that a reply is lost
    corrupt: float = 0.0  # probability that one byte of a reply is wrong
    wrong_id: float = 0.0  # probability that a reply bears another id
    truncate: float = 0.0  # probability that a reply is cut short
    duplicate: float = 0.0  # probability that a reply comes twice
    noise: float = 0.0  # probability that noise comes before a reply
    delay: float = 0.0  # probability that a reply, and those behind it, are held up
    lose_instruction: float = 0.0  # probability that no servo hears an instruction
    delay_s: float = DELAY_S  # delay of a delayed reply [s]
    offline: set[int] = field(default_factory=set)  # ids of servos that neither receive nor reply
    # True if a sync read ends at the first servo that does not reply, as some firmware reportedly does; otherwise
    # those behind it reply in its slot.
    stall_behind_missing: bool = False
    random: random.Random = field(default_factory=lambda: random.Random(0))  # noqa: S311 - repeatable faults, no secret

    def loses_instruction(self) -> bool:
        """Draw; return True when an instruction is lost."""
        return self._happens(self.lose_instruction)

    def hold_up_s(self) -> float:
        """Draw the delay of a reply [s]."""
        return self.delay_s if self._happens(self.delay) else 0.0

    def id_of_reply(self, servo_id: int) -> int:
        """Draw the id that a servo's reply bears."""
        if not self._happens(self.wrong_id):
            return servo_id
        return self.random.choice([other for other in SERVO_IDS if other != servo_id])

    def apply(self, packet: bytes) -> bytes:
        """Apply the other faults of replies to one; return the bytes that arrive."""
        if self._happens(self.drop):
            return b""
        if self._happens(self.corrupt):
            packet = self._with_wrong_byte(packet)
        if self._happens(self.truncate):
            packet = packet[: self.random.randrange(1, len(packet))]
        if self._happens(self.duplicate):
            packet += packet
        if self._happens(self.noise):
            packet = self.random.randbytes(self.random.randint(1, MAX_NOISE_BYTES)) + packet
        return packet

    def _happens(self, probability: float) -> bool:
        return probability > 0.0 and self.random.random() < probability

    def _with_wrong_byte(self, packet: bytes) -> bytes:
        at = self.random.randrange(len(packet))
        wrong = packet[at] ^ self.random.randrange(1, 256)
        return packet[:at] + bytes([wrong]) + packet[at + 1 :]
