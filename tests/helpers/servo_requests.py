"""Requests to emulated servos, and live commands that change what they answer."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import strategies as st

from robot.hardware.feetech.packets import checksum
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, goal_block

PING, READ, WRITE, REG_WRITE, ACTION, SYNC_READ, SYNC_WRITE = 1, 2, 3, 4, 5, 0x82, 0x83
RESTORE, REBOOT, BACKUP, CALIBRATE = 6, 8, 9, 11
ALL = 0xFE
IDS = [1, 2, 3, 4, 5, 6]


def packet(servo_id: int, code: int, parameters: Sequence[int] = ()) -> bytes:
    """An instruction as the host sends it."""
    body = bytes([servo_id, len(parameters) + 2, code, *parameters])
    return b"\xff\xff" + body + bytes([checksum(body)])


# All that the servos can tell.
QUESTIONS = [
    packet(ALL, SYNC_READ, [56, 15, *IDS]),
    *(packet(servo, READ, [0, 87]) for servo in (1, 3)),
    packet(3, PING),
]
# All that changes it.
CHANGES = [
    *(packet(3, WRITE, [Register.TORQUE_ENABLE, value]) for value in (0, 1, 128)),
    packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]),
    packet(ALL, SYNC_WRITE, [GOAL_ADDRESS, 7, 1, *goal_block(2200, 900), 3, *goal_block(1900, 300)]),
    packet(3, WRITE, [GOAL_ADDRESS, *goal_block(2500, 0)]),
    packet(3, WRITE, [Register.TORQUE_LIMIT, 100, 0]),
    packet(3, WRITE, [Register.HOMING_OFFSET, 20, 0]),
    packet(3, WRITE, [Register.RESPONSE_LEVEL, 0]),
    packet(3, WRITE, [Register.LOCK, 0]),
    packet(3, WRITE, [Register.ID, 9]),
    packet(9, WRITE, [Register.ID, 3]),
    packet(3, WRITE, [Register.BAUD_RATE, 1]),
    packet(3, WRITE, [Register.BAUD_RATE, 0]),
    packet(1, REG_WRITE, [GOAL_ADDRESS, *goal_block(2300, 500)]),
    packet(ALL, ACTION),
    *(packet(3, code) for code in (RESTORE, REBOOT, BACKUP, CALIBRATE)),
]
COMMANDS = [
    {"push": {"3": 200}},
    {"obstacle": {"1": 2100}},
    {"obstacle": {"1": None}},
    {"hand": {"1": 1800}},
    {"hand": {"1": None}},
    {"jump": {"3": 50}},
    {"temperature": {"3": 66}},
    {"heat_rate": 3600},
    {"voltage": {"3": 3.0}},
    {"status": {"3": 32}},
    {"status": {"3": 0}},
    {"offline": [1]},
    {"online": [1]},
    {"power_cycle": [3]},
    {"torque_off": [3]},
    {"powers_up_holding": [3]},
    {"stall_behind_missing": True},
    {"drop": 0.5},
    {"drop": 0.0},
    {"delay": 1.0, "delay_s": 0.2},
    {"delay": 0.0},
]
PACKETS = st.sampled_from(CHANGES + QUESTIONS)
# Whole instructions, several that come together, and some that end too early.
REQUESTS = st.one_of(
    PACKETS,
    st.tuples(PACKETS, PACKETS).map(b"".join),
    st.tuples(PACKETS, PACKETS, st.integers(1, 19)).map(lambda cut: (cut[0] + cut[1])[: -cut[2]]),
)
