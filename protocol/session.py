"""One client's protocol state: frames in, operations out; publications in, frames out.

The session touches no socket and reads no clock. Its driver hands it what arrives, asks the graph whether an
operation is acceptable, records it in `Session.publications` or `Session.subscriptions`, and sends what
`Session.data_to_send` returns.
"""

from __future__ import annotations

from dataclasses import dataclass

from protocol import operations
from protocol.codecs import json
from protocol.errors import FrameError, OperationError
from protocol.limits import Limits
from protocol.operations import Operation
from protocol.outbox import Outbox
from protocol.publication import Publication
from protocol.registrations import Publications
from protocol.subscriptions import Subscriptions


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a frame, or an operation in it, is not carried out.

    Attributes:
        op: the operation's name, None where none could be read.
        id: the operation's id, None where it has none.
        text: one line that names op, field, limit and value.
    """

    op: str | None
    id: str | int | None
    text: str


class Session:
    """The protocol state of one client.

    Args:
        limits: what the client may cost.

    Attributes:
        limits: as given.
        publications: the topics the client has advertised.
        subscriptions: the topics the client has subscribed to.
    """

    def __init__(self, limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self.publications = Publications(self.limits.max_publications)
        self.subscriptions = Subscriptions(self.limits.max_subscriptions)
        self._outbox = Outbox(self.limits)

    # What comes from the client.

    def receive_frame(self, frame: str | bytes) -> list[Operation | Refusal]:
        """Read one frame; text and binary frames carry the same JSON.

        Carry out the operations in this order, and log the refusals; the connection lives on after each of
        them. Nothing that a client sends makes this raise.
        """
        # Before decoding: what is too long must not cost the time and memory of being decoded.
        size_bytes = _size_bytes(frame)
        if size_bytes > self.limits.max_message_bytes:
            text = f"message of {size_bytes} bytes, the limit is {self.limits.max_message_bytes}"
            return [Refusal(None, None, text)]
        try:
            value = json.decode(frame)
        except FrameError as error:
            return [Refusal(None, None, str(error))]
        try:
            return [operations.parse(value)]
        except OperationError as error:
            return [Refusal(error.op, _id(value), str(error))]

    # What goes to the client.

    def deliver(self, publication: Publication, now: float) -> None:
        """Queue topic data, if the client has subscribed to the topic, under the rules of its subscription.

        After calling this, send what `data_to_send` returns as soon as the socket takes it.

        Args:
            publication: the message.
            now: present time [s], monotonic.
        """
        subscription = self.subscriptions.get(publication.topic)
        if subscription is not None and subscription.admit(now):
            self._outbox.put_topic_data(subscription, publication.frame(subscription.spelled_topic))

    def send(self, frame: bytes) -> None:
        """Queue a reply, which is never dropped; afterwards look at `overflowed`."""
        self._outbox.put_reply(frame)

    def data_to_send(self, now: float) -> list[bytes]:
        """Return the frames that are due, in order of queuing; send each as one text frame.

        Call it only when the socket takes data: what is not fetched is bounded here, what is fetched is not.

        Args:
            now: present time [s], monotonic.
        """
        return self._outbox.take_due(now)

    def next_due(self, now: float) -> float | None:
        """Return when to call `data_to_send` next [s]: `now` when data is due, None when nothing waits.

        Args:
            now: present time [s], monotonic.
        """
        return self._outbox.next_due(now)

    @property
    def overflowed(self) -> bool:
        """Whether replies piled up beyond ``max_queued_reply_bytes``: close the connection."""
        return self._outbox.overflowed

    @property
    def dropped(self) -> int:
        """Number of topic frames dropped because the client was slow or its queue_length was reached."""
        return self._outbox.dropped


def _size_bytes(frame: str | bytes) -> int:
    # Text knows whether it is ASCII without being read, and most frames are.
    if isinstance(frame, bytes) or frame.isascii():
        return len(frame)
    return len(frame.encode(errors="surrogatepass"))


def _id(value: object) -> str | int | None:
    """Return the id of an operation that could not be read, if it is one that can be sent back."""
    mark = value.get("id") if isinstance(value, dict) else None
    if isinstance(mark, str):
        return mark if len(mark) <= operations.MAX_ID_CHARACTERS else None
    return mark if type(mark) is int else None
