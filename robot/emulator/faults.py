"""What goes wrong on the emulated bus, by chance or on command."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from robot.hardware.feetech.packets import HEADER, checksum

# Faults that strike each packet with a probability, and what they do; field of Faults, option and live command alike.
PROBABILITIES: Mapping[str, str] = MappingProxyType(
    {
        "drop": "lose a reply",
        "corrupt": "damage one byte of a reply",
        "wrong_id": "let a reply bear another id, with a sound checksum",
        "truncate": "cut a reply short",
        "duplicate": "send a reply twice",
        "noise": "send noise before a reply",
        "delay": "hold up a reply and those behind it",
        "lose_instruction": "let no servo hear an instruction",
    }
)

# Longer than the driver waits for a reply: what is delayed comes when the next question has been asked.
DELAY_S = 0.02

MAX_NOISE_BYTES = 8

# Ids that a servo can have.
SERVO_IDS = range(0xFD)


@dataclass
class Faults:
    """Probabilities of faults and servos cut off; may be changed while the bus runs.

    Attributes:
        drop: see ``PROBABILITIES`` for this and all others that are probabilities.
        delay_s: how long a delayed reply takes longer [s].
        offline: ids of servos that neither hear nor speak.
        stall_behind_missing: whether a sync read ends at the first servo that does not answer, as some firmware is
            said to do; else those behind it answer in its stead.
        random: where chance comes from.
    """

    drop: float = 0.0
    corrupt: float = 0.0
    wrong_id: float = 0.0
    truncate: float = 0.0
    duplicate: float = 0.0
    noise: float = 0.0
    delay: float = 0.0
    lose_instruction: float = 0.0
    delay_s: float = DELAY_S
    offline: set[int] = field(default_factory=set)
    stall_behind_missing: bool = False
    random: random.Random = field(default_factory=lambda: random.Random(0))  # noqa: S311 - repeatable faults, no secret

    @property
    def by_chance(self) -> bool:
        """True while any fault may strike by chance."""
        return any(getattr(self, name) > 0.0 for name in PROBABILITIES)

    def loses_instruction(self) -> bool:
        """Choose whether an instruction is lost."""
        return self._happens(self.lose_instruction)

    def hold_up_s(self) -> float:
        """Choose how much later the host gets a reply [s]."""
        return self.delay_s if self._happens(self.delay) else 0.0

    def strike(self, packet: bytes) -> bytes:
        """Choose what arrives of a reply."""
        if self._happens(self.drop):
            return b""
        if self._happens(self.wrong_id):
            packet = self._with_wrong_id(packet)
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

    def _with_wrong_id(self, packet: bytes) -> bytes:
        own = packet[len(HEADER)]
        other = self.random.choice([servo_id for servo_id in SERVO_IDS if servo_id != own])
        body = bytes([other]) + packet[len(HEADER) + 1 : -1]
        return HEADER + body + bytes([checksum(body)])
