"""Emulated servos in the test's own process, in a time that the test or the bus moves on, and requests to them."""

import argparse
import json
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from hypothesis import strategies as st

from robot.control.pacing import LoopClock
from robot.emulator.arm import InProcessPort
from robot.emulator.control import Emulation, answer
from robot.emulator.process import add_options, build_bus, configure
from robot.emulator.servo_bus import EmulatedBus, Reply
from robot.hardware.feetech.bus import Bus, checksum
from robot.hardware.feetech.family import ACCELERATION
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S
from tests.helpers.robots import SO101


def goal_block(goal_ticks: int, velocity_ticks_s: int) -> bytes:
    """Build registers 41 to 47 of a Feetech servo: acceleration, goal, and velocity cap, 0 for none."""
    head, tail = Register.ACCELERATION.encode(ACCELERATION), Register.GOAL_VELOCITY.encode(velocity_ticks_s)
    return head + Register.GOAL_POSITION.encode(goal_ticks) + Register.GOAL_TIME.encode(0) + tail


class SteppedClock(LoopClock):
    """Time that passes when it is told to [s]."""

    def __init__(self, now_s: float = 100.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s

    def advance(self, seconds: float) -> None:
        self.now_s += seconds

    def start_tick(self, machine_s: float, at_most_s: float = 0.0) -> None:
        self.now_s = machine_s

    @property
    def real_time_factor(self) -> float:
        return 1.0


def options_parser() -> argparse.ArgumentParser:
    """Build the parser of ``armbridge emulate``, with a built-in arm that was read once."""
    parser = argparse.ArgumentParser()
    add_options(parser)
    parser.set_defaults(robot=SO101)
    return parser


class WiredPort(InProcessPort):
    """Port whose bytes take their time on the wire; who waits for them moves the clock."""

    def __init__(self, bus: EmulatedBus[Any], clock: SteppedClock) -> None:
        super().__init__(bus, clock)
        self.latency_s, self.quiet_s = LOCAL_LATENCY_S, QUIET_S
        self._stepped = clock

    def receive(self, timeout_s: float, /) -> bytes:
        data = super().receive(timeout_s)
        if data or timeout_s <= 0.0:
            return data
        self._stepped.advance(self.wait_s(self._clock(), timeout_s))
        return self._arrived()

    def _queue(self, replies: Sequence[Reply]) -> None:
        self.take(replies)


class SteppedEmulator:
    """Servos of ``armbridge emulate`` at an in-process port; with ``wire_time`` a wait for bytes moves the clock."""

    def __init__(self, *options: str, wire_time: bool = True) -> None:
        parser = options_parser()
        self.clock = SteppedClock()
        self._resources = ExitStack()
        parsed = parser.parse_args(options)
        self.servo_bus = build_bus(parsed, self._resources, self.clock(), wire_time=wire_time)
        self.port = (WiredPort if wire_time else InProcessPort)(self.servo_bus, self.clock)
        self._emulation = Emulation(self.servo_bus, self.port)
        configure(parsed, self._emulation)
        self._later: list[tuple[float, dict[str, object]]] = []

    def command(self, **command: object) -> dict[str, Any]:
        """Send one live command and return the answer."""
        answered: dict[str, Any] = json.loads(answer(json.dumps(command).encode(), self._emulation))
        return answered

    def command_later(self, delay_s: float, **command: object) -> None:
        """Send a live command while :meth:`run` lets so much time pass."""
        self._later.append((self.clock() + delay_s, command))

    def open_bus(self) -> Bus:
        """The host's end of the wire."""
        return Bus(self.port, self.clock)

    def run(self, seconds: float) -> None:
        """Let the servos move on their own, in steps of a tick as in a process of their own; also serves as a wait."""
        until_s = self.clock() + seconds
        while (left_s := until_s - self.clock()) > 0.0:
            self.clock.advance(min(left_s, 0.01))
            self.servo_bus.advance(self.clock())
            due = [command for due_s, command in self._later if due_s <= self.clock()]
            self._later = [(due_s, command) for due_s, command in self._later if due_s > self.clock()]
            for command in due:
                self.command(**command)

    def end(self) -> None:
        """Close the log."""
        self._resources.close()


PING, READ, WRITE, REG_WRITE, ACTION, SYNC_READ, SYNC_WRITE = 1, 2, 3, 4, 5, 0x82, 0x83
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
]
PACKETS = st.sampled_from(CHANGES + QUESTIONS)
# Whole instructions, several that come together, and some that end too early.
REQUESTS = st.one_of(
    PACKETS,
    st.tuples(PACKETS, PACKETS).map(b"".join),
    st.tuples(PACKETS, PACKETS, st.integers(1, 19)).map(lambda cut: (cut[0] + cut[1])[: -cut[2]]),
)
