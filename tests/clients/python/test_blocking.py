"""A call of the synchronous client may be interrupted anywhere by a signal handler that calls it too."""

import asyncio
import contextlib
import itertools
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest

from armbridge_client.blocking import LoopThread
from armbridge_client.errors import ConnectionLost
from harness.waiting import join

MOTION_S = 0.02


@pytest.fixture
def loop() -> Iterator[LoopThread]:
    made = LoopThread()
    yield made
    made.end()


class Motion:
    """A call that waits for the end of a motion, and a signal handler that stops the motion in one line of the call."""

    def __init__(self, loop: LoopThread, line: int) -> None:
        self.interrupted = False
        self._loop = loop
        self._lines_until = line
        self._ending = asyncio.Event()

    async def move(self) -> str:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._ending.wait(), MOTION_S)
        return "ended"

    async def stop(self) -> None:
        self._ending.set()
        for _ in range(5):  # the motion ends before the answer, as on a server
            await asyncio.sleep(0)

    def trace(self, _frame: FrameType, event: str, _argument: object) -> Any:
        """Stand for the signal: Python runs a handler between two steps of what it interrupts."""
        if event == "line" and not self.interrupted:
            self.interrupted = self._lines_until == 0
            self._lines_until -= 1
            if self.interrupted:
                self._loop.run(self.stop())
        return self.trace

    def run(self) -> str:
        moving = self.move()
        sys.settrace(self.trace)
        try:
            return self._loop.run(moving)
        finally:
            sys.settrace(None)


def test_a_signal_handler_in_any_line_of_a_call_may_end_what_the_call_waits_for(loop: LoopThread) -> None:
    lines: list[int] = []

    def interrupt_every_line() -> None:
        for line in itertools.count():
            motion = Motion(loop, line)
            assert motion.run() == "ended"
            if not motion.interrupted:
                break
            lines.append(line)

    thread = threading.Thread(target=interrupt_every_line, daemon=True)
    thread.start()
    join(thread)
    assert len(lines) > 10


def test_after_its_end_it_runs_nothing(loop: LoopThread) -> None:
    loop.end()

    async def nothing() -> None: ...

    with pytest.raises(ConnectionLost, match="has closed the connection"):
        loop.run(nothing())
