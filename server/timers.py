"""Calls after a delay, which tests replace by calls in a time of their own, and calls from other threads."""

import asyncio
import contextlib
from collections.abc import Callable

# Delay [s], and the function to call then; the timer can be cancelled.
CallLater = Callable[[float, Callable[[], None]], asyncio.TimerHandle]


def call_later(delay_s: float, action: Callable[[], None]) -> asyncio.TimerHandle:
    return asyncio.get_running_loop().call_later(delay_s, action)


def call_in_loop(loop: asyncio.AbstractEventLoop, function: Callable[..., object], *arguments: object) -> None:
    """Call a function in the event loop soon, from any thread; do nothing if the loop is closed."""
    # The server may have stopped while the other thread goes on.
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(function, *arguments)
