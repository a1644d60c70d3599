"""One client's protocol state: frames in, operations out; publications and replies in, frames out.

The session touches no socket and reads no clock. Its driver hands it what arrives, carries the operations out, records
topics in `Session.publications` or `Session.subscriptions`, answers with `Session.reply`, and sends what
`Session.data_to_send` returns.
"""

import itertools
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from protocol import operations
from protocol.codecs import bson, json, png
from protocol.dialect import Dialect
from protocol.errors import FrameError, OperationError
from protocol.framing import ObjectEnd, Reassembly
from protocol.limits import Limits
from protocol.operations import Advertise, Fragment, Operation, OperationId, Png
from protocol.publication import LARGE_BYTES, EncodedMessage, Encoding, Frame, PublishedMessage, pack
from protocol.send_queue import SendBudget, SendQueue
from protocol.subscriptions import Registrations, Subscription, Subscriptions

# Bytes taken out of the bounded queues at a time: large enough to keep a quick socket busy, small beside the queues.
SEND_BUDGET_BYTES = 65_536

# Each warning makes a client that is too slow slower still.
DROP_WARNING_PERIOD_S = 1.0

# Returns the fields of an operation whose message is large.
LaterFields: TypeAlias = Callable[[], Mapping[str, Any]]

# Each level includes the ones before it.
LEVELS = ("none", "error", "warning", "info")


@dataclass(frozen=True, slots=True)
class Refusal:
    """Reason for which a frame, or an operation in it, is not carried out; ``called`` names its service or action."""

    op: str | None
    id: OperationId
    text: str
    called: str = ""


@dataclass(frozen=True, slots=True)
class Packed:
    """Operation that is packed into another one; to unpack it takes a while."""

    packing: Fragment | Png
    data: str


# Start of an object: garbage seldom has a brace with a key, or nothing, behind it. At the end of the received data
# the rest may be still to come.
_START = re.compile(rb'\{(?=[ \t\r\n]*+(?:["}]|\Z))')

# Most bytes of something else before an object: clients send a few there, and a search through ten megabytes of braces
# takes a third of a second.
MAX_LEADING_BYTES = 1_024

# Refusals in one frame after which the rest of it is not read.
MAX_REFUSALS_PER_FRAME = 8


class FrameReader:
    """Reads frames in linear time: of one JSON object mostly, of several, of a piece, behind other text, or of BSON."""

    def __init__(self, limits: Limits) -> None:
        self.last_was_bson = False  # decides whether the answers are BSON
        self._limits = limits
        # Data from the start of an object whose end has not come yet, and the search for that end.
        self._pending = bytearray()
        self._end = ObjectEnd()

    @property
    def between_objects(self) -> bool:
        """True when the next frame is read by itself, and the client speaks JSON."""
        return not self._pending and not self.last_was_bson

    def feed(self, frame: str | bytes) -> list[object | FrameError]:
        """Return the values that end in this frame, in order; an error stands for a value that cannot be decoded."""
        self.last_was_bson = isinstance(frame, bytes) and bson.is_document(frame)
        try:
            if isinstance(frame, bytes) and self.last_was_bson:
                return [bson.decode(frame)]
            value = json.decode(frame)
        except FrameError as error:
            return [error] if self.last_was_bson else self._read_on(frame, error)
        if not self._pending:
            return [value]
        # Behind an operation the pending object never ends; any other value may belong into its middle.
        if isinstance(value, dict) and "op" in value:
            return [*self._give_up(), value]
        return self._read_on(frame, FrameError("not an operation"))

    def _read_on(self, frame: str | bytes, error: FrameError) -> list[object | FrameError]:
        """Look for objects in what came before and this frame, which is none by itself."""
        try:
            data = frame if isinstance(frame, bytes) else frame.encode()
        except UnicodeEncodeError:
            return [error]
        size_bytes = len(self._pending) + len(data)
        if size_bytes > self._limits.max_message_bytes:
            self._pending.clear()
            problem = f"an object without an end after {size_bytes} bytes, the limit is"
            return [FrameError(f"{problem} {self._limits.max_message_bytes}")]
        found = self._find_objects(data)
        return found if found or self._pending else [error]

    def _find_objects(self, data: bytes) -> list[object | FrameError]:
        found: list[object | FrameError] = []
        refusals = 0
        opened = bool(self._pending)
        self._pending += data
        while opened or self._open():
            opened = False
            try:
                if not self._end.find(self._pending):
                    return found
                found.append(json.decode(bytes(self._pending[: self._end.position])))
            except FrameError as error:
                found.append(error)
                refusals += 1
            del self._pending[: self._end.position]
            if refusals == MAX_REFUSALS_PER_FRAME or len(found) == self._limits.max_objects_per_frame:
                found += self._give_up()
        return found

    def _open(self) -> bool:
        start = _START.search(self._pending, 0, MAX_LEADING_BYTES)
        if start is not None:
            # The end of the search may have been taken for the end of the text.
            start = _START.match(self._pending, start.start())
        del self._pending[: len(self._pending) if start is None else start.start()]
        self._end = ObjectEnd()
        return start is not None

    def _give_up(self) -> list[object | FrameError]:
        size_bytes = len(self._pending)
        self._pending.clear()
        return [FrameError(f"{size_bytes} bytes in which no object ends are given up")] if size_bytes else []


# A client's next operations wait while this many bytes of replies wait to be read, or this share of their bound.
CONGESTED_BYTES = 262_144
CONGESTED_SHARE = 0.25


class Session:
    """The protocol state of one client.

    ``newest_only`` lets a subscription begin with at most the newest of the messages before it. ``send_at_once`` is
    offered a message when nothing waits before it, and returns True when it has sent it: clients that keep up bypass
    the queue.
    """

    def __init__(
        self,
        limits: Limits | None = None,
        dialect: Dialect = "ros2",
        budget: SendBudget | None = None,
        *,
        newest_only: bool = False,
        send_at_once: Callable[[EncodedMessage], bool] = lambda _encoded: False,
    ) -> None:
        self.limits = limits or Limits()
        self.publications: Registrations[Advertise] = Registrations(
            "advertise", "unadvertise", self.limits.max_publications
        )
        self.subscriptions = Subscriptions(self.limits.max_subscriptions)
        # None asked for: some clients log a traceback for every status message.
        self.status_level = "none"
        self.dialect = dialect
        self.newest_only = newest_only
        self._send_at_once = send_at_once
        self.send_queue = SendQueue(self.limits, budget)
        self._reader = FrameReader(self.limits)
        self._reassembly = Reassembly(self.limits)
        self._fragment_size: int | None = None
        self._fragment_ids = itertools.count(1)
        # Number of dropped messages at the last warning of them, and its time [s].
        self._warned_drops = 0
        self._warned_s = -math.inf
        # Feedback may be dropped like topic data; all goals share one lane, so that it keeps its order.
        self._feedback = Subscription("feedback of goals")

    # What comes from the client.

    def receive_frame(self, frame: str | bytes, now: float) -> list[Operation | Refusal | Packed]:
        """Read one frame of JSON or BSON; nothing in it makes this raise.

        Carry out the operations in this order, unpack `Packed` ones in their place, and log the refusals. A thread may
        read a long frame, while no other frame of this client is read.
        """
        # Before decoding: an oversized frame must not cost the time and memory of its decoding.
        size_bytes = json.size_bytes_of(frame)
        if size_bytes > self.limits.max_message_bytes:
            text = f"message of {size_bytes} bytes, the limit is {self.limits.max_message_bytes}"
            return [Refusal(None, None, text)]
        return [item for value in self._reader.feed(frame) for item in self._read(value, now)]

    def peek(self, frame: str | bytes) -> Operation | None:
        """Read a frame ahead of the frames before it; None for a frame that is not one operation in JSON or BSON."""
        is_bson = isinstance(frame, bytes) and bson.is_document(frame)
        try:
            value = bson.decode(frame) if isinstance(frame, bytes) and is_bson else json.decode(frame)
            operation = operations.parse(value)
        except (FrameError, OperationError):
            return None
        self._reader.last_was_bson = is_bson
        return operation

    def reads_by_itself(self, frame: str) -> bool:
        """Return True for a frame that may be read without :meth:`receive_frame`, by itself alone."""
        return self._reader.between_objects and self.dialect == "ros2" and len(frame) <= self.limits.max_message_bytes

    def unpack(self, packed: Packed) -> Operation | Refusal:
        """Read what was packed into fragments or a picture, in any thread."""
        packing = packed.packing
        try:
            value = json.decode(png.decode(packed.data) if isinstance(packing, Png) else packed.data)
        except FrameError as error:
            return Refusal(packing.op, packing.id, f"{packing.op}: field data: {error}")
        item = self._parse(value)
        # Fragments of fragments serve nobody, and each layer would cost the work of a whole message.
        if isinstance(item, Fragment | Png):
            problem = f"{packing.op}: field data: wanted an operation inside, got another {item.op}"
            return Refusal(packing.op, packing.id, problem)
        return item

    def _read(self, value: object, now: float) -> list[Operation | Refusal | Packed]:
        item = self._parse(value)
        if isinstance(item, Png):
            return [Packed(item, item.data)]
        if not isinstance(item, Fragment):
            return [item]
        try:
            text = self._reassembly.add(item, now)
        except OperationError as error:
            return [Refusal(error.op, item.id, str(error))]
        return [] if text is None else [Packed(item, text)]

    def _parse(self, value: object) -> Operation | Refusal:
        if isinstance(value, FrameError):
            return Refusal(None, None, str(value))
        try:
            operation = operations.parse(value)
        except OperationError as error:
            return Refusal(error.op, _id(value), str(error), _called(value))
        if operation.fragment_size is not None:
            self._fragment_size = operation.fragment_size
        return operation

    # What goes to the client.

    def deliver(self, published: PublishedMessage, now: float) -> bool:
        """Queue topic data under the rules of the client's subscription; return True when it was queued.

        Raises ProtocolError for a message that cannot be encoded as the subscription wants it.
        """
        subscription = self.subscriptions.get(published.topic)
        if subscription is None or not subscription.admit(now):
            return False
        encoding: Encoding = subscription.compression
        if encoding == "none" and self._reader.last_was_bson:
            encoding = "bson"
        size = subscription.fragment_size or self._fragment_size
        encoded = published.encoded(subscription.spelled_topic, encoding, self.dialect, size)
        at_once = encoded.ready and now >= subscription.due_s and self.send_queue.empty
        if not at_once or not self._send_at_once(encoded):
            self.send_queue.put_topic_data(subscription, encoded, now)
            return True
        subscription.sent(now)
        return False

    def reply(self, fields: Mapping[str, Any] | LaterFields) -> bool:
        """Send or queue an operation, which is never dropped; True when it was queued. Afterwards look at `overflowed`.

        ``fields`` of a large message is a function, called by :meth:`EncodedMessage.encode`.
        """
        encoded = self._encode_message(fields)
        if self.send_queue.empty and encoded.ready and self._send_at_once(encoded):
            return False
        self.send_queue.put_reply(encoded)
        return True

    def ask(self, fields: Mapping[str, Any] | LaterFields) -> bool:
        """Send or queue a call or goal for the client's offer; False, with nothing queued, when too many wait."""
        encoded = self._encode_message(fields)
        if self.send_queue.empty and encoded.ready and self._send_at_once(encoded):
            return True
        return self.send_queue.put_request(encoded)

    def feedback(self, fields: Mapping[str, Any] | LaterFields, now: float) -> None:
        """Queue an action_feedback, dropped when the client reads too slowly."""
        self.send_queue.put_topic_data(self._feedback, self._encode_message(fields), now, in_order=True)

    def status(
        self, level: Literal["error", "warning", "info"], text: str, id_: OperationId, *, unasked: bool = False
    ) -> None:
        """Queue a status message, if the client has asked for this level or it is ``unasked``."""
        if unasked or LEVELS.index(level) <= LEVELS.index(self.status_level):
            self.reply(with_id({"op": "status", "level": level, "msg": text}, id_))

    def data_to_send(self, now: float) -> list[EncodedMessage]:
        """Return due messages, `SEND_BUDGET_BYTES` and one message at most; call it when the socket takes data."""
        if self.dropped > self._warned_drops:
            self._warn_of_drops(now)
        return self.send_queue.take_due(now, SEND_BUDGET_BYTES)

    @property
    def speaks_bson(self) -> bool:
        """True when the client is answered in BSON, as its last frame was."""
        return self._reader.last_was_bson

    @property
    def congested(self) -> bool:
        """True while too many replies wait to be read for the client's next operations."""
        limit_bytes = min(CONGESTED_BYTES, CONGESTED_SHARE * self.limits.max_queued_reply_bytes)
        return self.send_queue.reply_bytes > limit_bytes

    @property
    def dropped(self) -> int:
        """Number of topic messages dropped because the client was slow, not by its own throttle."""
        return self.send_queue.dropped - self.send_queue.throttled

    def _warn_of_drops(self, now: float) -> None:
        """Warn of dropped messages; only a client that reads gets here, and not too often."""
        if now >= self._warned_s + DROP_WARNING_PERIOD_S:
            self.status(
                "warning", f"{self.dropped - self._warned_drops} messages dropped: they are read too slowly", None
            )
            self._warned_drops, self._warned_s = self.dropped, now

    def _encode(self, fields: Mapping[str, Any], encode_json: Callable[[object], bytes] = json.encode) -> Frame:
        if self.speaks_bson:
            return Frame(bson.encode(fields), text=False)
        return Frame(encode_json(fields), text=True)

    def _encode_message(self, fields: Mapping[str, Any] | LaterFields) -> EncodedMessage:
        fragment_size, fragment_id = self._fragment_size, f"reply:{next(self._fragment_ids)}"
        if isinstance(fields, Mapping):
            return pack(self._encode(fields), fragment_size, fragment_id)
        return EncodedMessage.later(
            lambda: pack(self._encode(fields(), json.encode_in_pieces), fragment_size, fragment_id), LARGE_BYTES
        )


def with_id(fields: dict[str, Any], id_: OperationId) -> dict[str, Any]:
    """Return an operation with the id that it answers to, which is left out where none was sent."""
    return fields if id_ is None else {**fields, "id": id_}


def _id(value: object) -> OperationId:
    """Return the id of an operation that could not be read; None for an id that cannot be sent back."""
    id_ = value.get("id") if isinstance(value, dict) else None
    if isinstance(id_, str):
        return id_ if len(id_) <= operations.MAX_ID_CHARACTERS else None
    return id_ if type(id_) is int or (type(id_) is float and math.isfinite(id_)) else None


def _called(value: object) -> str:
    """Return the service or action that an operation names; empty for a name that cannot be sent back."""
    name = (value.get("service") or value.get("action")) if isinstance(value, dict) else None
    return name if isinstance(name, str) and len(name) <= operations.MAX_NAME_CHARACTERS else ""
