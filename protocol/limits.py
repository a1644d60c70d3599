"""Limits on the resources of one client."""

from pydantic import BaseModel, ConfigDict, Field

# Pieces of one message, in and out: the largest message in pieces of a kilobyte, which is as small as clients cut. The
# envelope of a piece costs a hundred bytes, so a message in pieces of one character would cost a hundredfold.
MAX_PIECES = 10_000

# All that waits for all clients of a server. Four that stand still may fill it, for a few seconds.
MAX_SERVER_QUEUED_BYTES = 256_000_000


class Limits(BaseModel):
    """Limits of one client: sizes, numbers and times; see docs/protocol.md."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    # rosbridge_server's max_message_size, which its clients are used to.
    max_message_bytes: int = Field(default=10_000_000, ge=65_536, le=100_000_000)
    """size of a frame, of an object in several frames, and of all fragments that wait for others [bytes]."""
    # Clients that do not wait for the socket run a few operations together.
    max_objects_per_frame: int = Field(default=1_000, ge=1, le=100_000)
    """operations in one frame."""
    max_fragments: int = Field(default=MAX_PIECES, ge=1, le=1_000_000)
    """fragments of one message, and of all incomplete messages."""
    # One message after the other is what clients send; a few more for those that interleave.
    max_fragmented_messages: int = Field(default=16, ge=1, le=10_000)
    """incomplete messages, whose fragments have not all come."""
    # rosbridge_server's fragment_timeout.
    fragment_timeout_s: float = Field(default=600.0, ge=1.0, le=86_400.0)
    """a message whose fragments do not all come within this time is dropped [s]."""
    # A client that lists every topic of a large robot subscribes to a few hundred.
    max_subscriptions: int = Field(default=1_000, ge=1, le=100_000)
    """subscriptions."""
    max_publications: int = Field(default=1_000, ge=1, le=100_000)
    """topics that it advertises."""
    # A client that stands for a whole robot offers a few dozen.
    max_offers: int = Field(default=1_000, ge=0, le=100_000)
    """services that it offers, and as many actions."""
    # Clients call one by one, or a burst at their start.
    max_calls_in_flight: int = Field(default=1_000, ge=1, le=100_000)
    """calls of services that wait for their responses, and as many goals on actions."""
    # rosbridge_server's default_call_service_timeout.
    call_timeout_s: float = Field(default=5.0, ge=0.1, le=3600.0)
    """time in which a service that it offers must answer, where the caller names none [s]."""
    # Two seconds of pictures of 1 MB at 30 Hz.
    max_queued_bytes: int = Field(default=64_000_000, ge=65_536, le=10_000_000_000)
    """all data that waits for it; the oldest messages of topics are dropped [bytes]."""
    # A queue of small messages is given up in 50 ms, not in half a second.
    max_queued_messages: int = Field(default=20_000, ge=100, le=1_000_000)
    """messages of topics that wait for it; beyond, the oldest are dropped."""
    # A client further behind wants the newest. A computer that is suspended, or a page at a breakpoint, is not worth
    # more memory for longer.
    max_topic_delay_s: float = Field(default=5.0, ge=0.1, le=3600.0)
    """age of a subscription's waiting messages, and the time that messages wait for a client that reads nothing [s]."""
    # Others fill it: beyond it calls and goals fail, and the provider stays.
    max_queued_request_bytes: int = Field(default=16_000_000, ge=65_536, le=100_000_000)
    """calls and goals that wait for a slow client; further ones fail [bytes]."""
    # With the limit above less than all that may wait, so that topic data is not shut out: eighty answers of 400 kB.
    max_queued_reply_bytes: int = Field(default=32_000_000, ge=65_536, le=100_000_000)
    """replies that wait for a slow client; beyond, it is disconnected [bytes]."""
