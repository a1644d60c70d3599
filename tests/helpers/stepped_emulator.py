"""Emulated servos in the test's own process, with a clock that the test or the bus moves on."""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from typing import Any

from robot.emulator.control import Emulation, answer
from robot.emulator.in_process import InProcessPort
from robot.emulator.process import add_options, build_bus
from robot.hardware.clock import LoopClock
from robot.hardware.feetech.bus import Bus


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


class SteppedEmulator:
    """The servos of ``armbridge emulate``, by its options, at the other end of an in-process port.

    Args:
        options: of the command line.
        wire_time: whether bytes take their time on the wire; who waits for them then moves the clock.
    """

    def __init__(self, *options: str, wire_time: bool = True) -> None:
        parser = argparse.ArgumentParser()
        add_options(parser)
        self.clock = SteppedClock()
        self._resources = ExitStack()
        parsed = parser.parse_args(options)
        self.servo_bus = build_bus(parsed, self._resources, self.clock(), wire_time=wire_time)
        self.port = InProcessPort(self.servo_bus, self.clock, self.clock.advance if wire_time else None)
        self._emulation = Emulation(self.servo_bus, self.port)
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
