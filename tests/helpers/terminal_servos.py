"""A peer on a pseudo terminal that answers by a script, in real time."""

import contextlib
import os
import select
import threading
import time
import tty
from collections import deque

from robot.control.pacing import take_priority
from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Instruction, InstructionParser
from robot.hardware.feetech.bus import Bus
from tests.helpers.scripted_servos import Script

END_TIMEOUT_S = 5.0


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
