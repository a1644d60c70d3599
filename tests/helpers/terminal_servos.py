"""Servos on a pseudo terminal, in real time: an emulator process, and a peer that answers by a script."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
import tty
from collections import deque

from robot.control.realtime import take_priority
from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Instruction, InstructionParser
from robot.hardware.feetech.bus import Bus
from tests.helpers.scripted_servos import Script

START_TIMEOUT_S = 10.0
END_TIMEOUT_S = 5.0


class RunningEmulator:
    """An emulator process and the test's end of its control socket."""

    def __init__(self, *options: str) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "robot.emulator", "--control-fd", str(theirs.fileno()), *options],
                pass_fds=[theirs.fileno()],
            )
        ours.settimeout(START_TIMEOUT_S)
        self._socket = ours
        self._lines = ours.makefile("rb")
        self.port: str = json.loads(self._lines.readline())["port"]

    def command(self, **command: object) -> dict[str, object]:
        """Send one live command and return the answer."""
        self._socket.sendall(json.dumps(command).encode() + b"\n")
        answer: dict[str, object] = json.loads(self._lines.readline())
        return answer

    def let_go(self) -> None:
        """Close the control socket."""
        self._lines.close()
        self._socket.close()

    def end(self) -> None:
        """End the process, whatever it does."""
        self.let_go()
        self.process.terminate()
        self.process.wait(END_TIMEOUT_S)


class ScriptedPeer:
    """The far end of a pseudo terminal that answers every instruction with what a script says, in real time."""

    def __init__(self, script: Script) -> None:
        self.script = script
        self.instructions: list[Instruction] = []
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._wake, self._woken = os.pipe()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        take_priority()  # of this thread: servos do not wait for a busy computer
        parser = InstructionParser(FEETECH)
        send_queue: deque[tuple[float, bytes]] = deque()
        while True:
            now = time.monotonic()
            wait = max(0.0, send_queue[0][0] - now) if send_queue else None
            ready, _, _ = select.select([self._master, self._wake], [], [], wait)
            if self._wake in ready:
                return
            now = time.monotonic()
            if self._master in ready:
                for instruction in parser.feed(os.read(self._master, 4096), now):
                    self.instructions.append(instruction)
                    for delay_s, data in self.script(instruction):
                        last_due = send_queue[-1][0] if send_queue else now
                        send_queue.append((max(last_due, now + delay_s), data))
            while send_queue and send_queue[0][0] <= now:
                os.write(self._master, send_queue.popleft()[1])

    def open_bus(self) -> Bus:
        return Bus.open(self.port)

    def unplug(self) -> None:
        """Take the line away, as when the adapter is pulled."""
        os.write(self._woken, b"x")
        self._thread.join(END_TIMEOUT_S)
        for descriptor in (self._master, self._slave, self._wake, self._woken):
            with contextlib.suppress(OSError):
                os.close(descriptor)
        self._master = self._slave = self._wake = self._woken = -1

    def end(self) -> None:
        if self._master >= 0:
            self.unplug()
