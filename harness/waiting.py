"""Waits until something is so: never for a time in which it should be so."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

# What takes a millisecond takes much longer on a busy machine.
TIMEOUT_S = 30.0


async def until(condition: Callable[[], object], timeout_s: float = TIMEOUT_S) -> None:
    """Let the event loop run until something is so."""
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.005)


def wait_until(condition: Callable[[], object], timeout_s: float = TIMEOUT_S) -> None:
    """As :func:`until`, without an event loop."""
    until_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until_s, "it has not come to it in time"
        time.sleep(0.005)


async def given_up(*asking: asyncio.Task[Any]) -> None:
    """Cancel tasks that are not done, and wait for their end."""
    for task in asking:
        assert not task.done()
        task.cancel()
    await asyncio.wait(asking)
