"""Bounds on waiting: what happens when something does not."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol


class Timer(Protocol):
    """Something that is going to happen, unless it is cancelled before."""

    def cancel(self) -> None:
        """See that it does not happen; nothing happens when it already has."""


# Delay [s], and what to do then.
CallLater = Callable[[float, Callable[[], None]], Timer]


def call_later(delay_s: float, action: Callable[[], None]) -> Timer:
    """Do something after a delay, on the running event loop."""
    return asyncio.get_running_loop().call_later(delay_s, action)
