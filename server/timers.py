"""Calls after a delay, which tests replace by calls in a time of their own."""

import asyncio
from collections.abc import Callable

# Delay [s], and the function to call then; the timer can be cancelled.
CallLater = Callable[[float, Callable[[], None]], asyncio.TimerHandle]


def call_later(delay_s: float, action: Callable[[], None]) -> asyncio.TimerHandle:
    return asyncio.get_running_loop().call_later(delay_s, action)
