"""Stop epochs: a count of all stops, by which a stop ends every motion that was requested before it.

Every stop of an arm begins a new epoch. A request that may move an arm keeps the epoch in which it arrived, however
long it then waits; an arm refuses a request from an epoch before its own last stop. The count is shared by all arms of
a process, so that one number orders a request and the stops of each arm.
"""

STOPPED_SINCE = "a stop came after this motion was requested"


class StopEpochs:
    """Count of stops."""

    def __init__(self) -> None:
        self.present = 0  # epoch of what arrives now

    def begin(self) -> int:
        """Begin a new epoch, for a stop; return it."""
        self.present += 1
        return self.present


STOP_EPOCHS = StopEpochs()
