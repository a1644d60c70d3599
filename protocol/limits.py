"""What one client may cost."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Bounds of one client's session."""

    # rosbridge_server's max_message_size, which its clients are used to.
    max_message_bytes: int = 10_000_000
    # A client that lists every topic of a large robot subscribes to a few hundred.
    max_subscriptions: int = 1_000
    # As for subscriptions.
    max_publications: int = 1_000
    # Ten seconds of joint states at 100 Hz with room to spare: a client further behind wants the newest.
    max_queued_topic_bytes: int = 1_048_576
    # With the topic data, 2 MiB for a client that stops reading.
    max_queued_reply_bytes: int = 1_048_576
