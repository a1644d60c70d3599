"""What is counted while the arm runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class BusCounters:
    """What happened on the bus since it was opened.

    Attributes:
        sent: instructions written.
        replies: valid replies received.
        timeouts: replies that were expected and did not come, or not soundly.
        discarded_bytes: bytes that belonged to no valid reply.
        retries: instructions repeated because the servo gave no valid reply.
    """

    sent: int = 0
    replies: int = 0
    timeouts: int = 0
    discarded_bytes: int = 0
    retries: int = 0
