"""Limits on the resources of one client."""

from __future__ import annotations

from dataclasses import dataclass

# Pieces of one message, in and out: the largest message in pieces of a kilobyte, which is as small as clients cut. The
# envelope of a piece costs a hundred bytes, so a message in pieces of one character would cost a hundredfold.
MAX_PIECES = 10_000

# All that waits for all clients of a server. Four that stand still may fill it, for a few seconds.
MAX_SERVER_QUEUED_BYTES = 256_000_000


@dataclass(frozen=True)
class Limits:
    """Bounds of one client's session."""

    # rosbridge_server's max_message_size, which its clients are used to. It bounds a frame, an object that comes in
    # several frames, and all fragments that wait for others.
    max_message_bytes: int = 10_000_000
    # Clients that do not wait for the socket run a few operations together.
    max_objects_per_frame: int = 1_000
    # Of one message, and over all that wait for others.
    max_fragments: int = MAX_PIECES
    # One message after the other is what clients send; a few more for those that interleave.
    max_fragmented_messages: int = 16
    # rosbridge_server's fragment_timeout.
    fragment_timeout_s: float = 600.0
    # A client that lists every topic of a large robot subscribes to a few hundred.
    max_subscriptions: int = 1_000
    # As for subscriptions.
    max_publications: int = 1_000
    # Services, and as many actions; a client that stands for a whole robot offers a few dozen.
    max_offers: int = 1_000
    # Calls that wait for their responses, and as many goals; clients call one by one, or a burst at their start.
    max_calls_in_flight: int = 1_000
    # rosbridge_server's default_call_service_timeout: for the answer of a service that this client offers.
    call_timeout_s: float = 5.0
    # Everything that waits for a client; topic data gives way: two seconds of pictures of 1 MB at 30 Hz.
    max_queued_bytes: int = 64_000_000
    # Messages of topics among it, so that a queue of small ones is given up in 50 ms, not in half a second.
    max_queued_messages: int = 20_000
    # Topic data of one subscription: a client further behind wants the newest. With a client that stands still, all
    # topic data: a computer that is suspended, or a page at a breakpoint, is not worth more memory for longer.
    max_topic_delay_s: float = 5.0
    # Calls and goals for a provider, which others fill: beyond it they fail, and the provider stays.
    max_queued_request_bytes: int = 16_000_000
    # With the one above less than all that may wait, so that topic data is not shut out: eighty answers of 400 kB.
    max_queued_reply_bytes: int = 32_000_000
