"""Stop epochs: a count of all stops, by which a stop ends every motion that was requested before it.

Every stop of an arm begins a new epoch. A request that may move an arm keeps the epoch in which it arrived, however
long it then waits; an arm refuses a request from an epoch before its own last stop. The count is shared by all arms of
a process, so that one number orders a request and the stops of each arm.
"""

from typing import Protocol

STOPPED_SINCE = "a stop came after this motion was requested"


class Receiver(Protocol):
    """Receiver of requests; some may have arrived and not be read yet."""

    def date_unread(self) -> None:
        """Note that unread requests have arrived in the present epoch."""


class StopEpochs:
    """Count of stops."""

    def __init__(self) -> None:
        self.present = 0  # epoch of what arrives now
        self.receivers: set[Receiver] = set()

    def begin(self) -> int:
        """Begin a new epoch, for a stop; return it."""
        for receiver in self.receivers:
            receiver.date_unread()
        self.present += 1
        return self.present


STOP_EPOCHS = StopEpochs()
