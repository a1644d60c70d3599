"""Stop epochs: numbers of all stops, by which a stop ends every motion that was requested before it.

Every stop of an arm begins a new epoch. A request that may move an arm keeps the epoch in which it arrived, however
long it then waits; an arm refuses a request from an epoch before its own last stop. All arms of a process share the
numbers, so that one orders a request and the stops of each arm.

A client may name the last epoch that it knew of: its request then counts as one of that epoch. So each number is the
time of its stop, and an arm begins with one: a number that a client kept from an earlier run of the server is older.
"""

import time
from collections.abc import Callable
from typing import Protocol

STOPPED_SINCE = "the arm was stopped after this motion was requested, or decided on (after_stop)"


class Receiver(Protocol):
    """Receiver of requests; some may have arrived and not be read yet."""

    def date_unread(self) -> None:
        """Note that unread requests have arrived in the present epoch."""


class StopEpochs:
    """Numbers of stops: times [us since 1970], exact as float64 until 2255; increasing if the clock is set back."""

    def __init__(self) -> None:
        self.present = 0  # epoch of what arrives now
        self.receivers: set[Receiver] = set()
        self.listeners: set[Callable[[], None]] = set()  # called after each stop

    def begin(self) -> int:
        """Begin a new epoch, for a stop; return it."""
        for receiver in self.receivers:
            receiver.date_unread()
        self.present = max(self.present + 1, time.time_ns() // 1000)
        for listener in self.listeners:
            listener()
        return self.present


STOP_EPOCHS = StopEpochs()
