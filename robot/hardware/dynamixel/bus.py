"""Dynamixel's bus: packets of protocol 2.0, sent by ``dynamixel_sdk``.

Replies are received without the SDK, which polls for up to 34 ms for each, more than three ticks.
"""

from __future__ import annotations

from collections.abc import Sequence

from dynamixel_sdk import INST_REBOOT, PacketHandler

from robot.hardware.dynamixel.packets import (
    ALERT,
    StatusFrame,
    instruction_packet,
    parse_status_frames,
    status_bytes,
    stuffed_bytes,
)
from robot.hardware.dynamixel.registers import TABLE
from robot.hardware.servos.bus import Sdk, ServoBus

PROTOCOL = 2.0

# Longest delay of a reply, register RETURN_DELAY_TIME of 254; the factory's 250 is hardly less.
LONGEST_RETURN_DELAY_S = 254 * 2e-6


class Bus(ServoBus):
    """Bus of any number of Dynamixel servos."""

    registers = TABLE
    word_bytes = 2

    def _make_sdk(self) -> Sdk:
        sdk: Sdk = PacketHandler(PROTOCOL)
        return sdk

    def _packet(self, servo_id: int, instruction: int, parameters: Sequence[int]) -> list[int]:
        return instruction_packet(servo_id, instruction, parameters)

    def _parse_replies(self, received: bytes, ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        return parse_status_frames(received, ids, data_length)

    def _reply_bytes(self, data_length: int, replies: int) -> int:
        return status_bytes(data_length, replies)

    def _added_bytes(self, received: bytes) -> int:
        return stuffed_bytes(received)

    def _answer_delay_s(self, replies: int) -> float:
        return replies * LONGEST_RETURN_DELAY_S

    def _instruction_error(self, error: int) -> int:
        """Return 4 and 6 for a value out of its range, 7 for a register that cannot be written now.

        E-manual, DYNAMIXEL Protocol 2.0, Status Packet, Error.
        """
        return error & ~ALERT

    def _note_disturbance(self) -> None:
        super()._note_disturbance()
        # A reply that has not come yet may still come.
        self._last_byte_s = self._clock()


def reboot(bus: ServoBus, servo_id: int) -> None:
    """Reboot a servo: torque off, RAM as after power-up, latched errors cleared; it answers again a while later.

    NoReply: the servo did not acknowledge, but may reboot nevertheless.
    """
    bus.ask(servo_id, instruction_packet(servo_id, INST_REBOOT), attempts=1)
