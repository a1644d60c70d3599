"""Arrival of requests: the stop epoch in which the request arrived for which code runs.

The gateway notes the epoch when a frame arrives, before any queue or thread, and sets it while the frame's operations
are carried out. Tasks that are started meanwhile inherit it, so that a part of the server that starts a motion, however
much later, can name the epoch of the request to the arm.
"""

import contextlib
import math
from collections.abc import Iterator
from contextvars import ContextVar

from protocol.errors import OperationError, describe
from robot.stop_epochs import STOP_EPOCHS

_EPOCH: ContextVar[int | None] = ContextVar("stop epoch of the request", default=None)


def arrival_epoch() -> int:
    """Return the stop epoch in which the present request arrived; the present one for work that no request started."""
    epoch = _EPOCH.get()
    return STOP_EPOCHS.present if epoch is None else epoch


def is_stopped(last_stop: int, epoch: int | None = None) -> bool:
    """Return True when a stop of an arm came after a request arrived: the one rule by which stops end requests."""
    return (arrival_epoch() if epoch is None else epoch) < last_stop


def epoch_after(after_stop: object, epoch: int) -> int:
    """Return the stop epoch of a request that arrived in an epoch, after a stop that its client names.

    Args:
        after_stop: number of the last stop that the client knew of, as it came; None where it names no stop.
        epoch: stop epoch in which the request arrived.

    Raises:
        OperationError: this server has made no such number.
    """
    if after_stop is None:
        return epoch
    present = STOP_EPOCHS.present
    # Clients of JavaScript send BSON's doubles.
    number = math.nan
    if isinstance(after_stop, int | float) and not isinstance(after_stop, bool):
        number = after_stop
    if not 0 <= number <= present or number != int(number):
        limits = f"must be a whole number from 0 to {present}, the present value of stops in /arm/state"
        raise OperationError(None, "after_stop", f"{limits}, not {describe(after_stop)}")
    return min(epoch, int(number))


@contextlib.contextmanager
def arrived_in(epoch: int) -> Iterator[None]:
    """Carry out a request that arrived in a stop epoch."""
    token = _EPOCH.set(epoch)
    try:
        yield
    finally:
        _EPOCH.reset(token)
