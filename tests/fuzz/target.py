"""What a fuzzer feeds with any bytes: four clients on one graph."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cbor2
import orjson
from bson import decode as decode_bson

from protocol.codecs.bson import is_document
from protocol.limits import Limits
from protocol.publication import Frame
from protocol.session import Session
from server.access.authentication import AuthThrottle
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.gateway.client import Client
from server.gateway.client_context import ClientContext, Gateway
from server.gateway.turns import Turns, encode_or_log
from server.graph.permissions import ANYONE, Identity, Node, Role
from server.graph.topics import Graph
from server.rosapi import RosApi
from tests.helpers.clock import FakeClock
from tests.helpers.gateway import AtOnce, UnreadSocket
from tests.helpers.messages import REGISTRY

CORPUS = Path(__file__).parent / "corpus"

# Small limits are reached by small inputs.
LIMITS = Limits.model_construct(
    max_message_bytes=200_000,
    max_fragments=100,
    max_fragmented_messages=4,
    fragment_timeout_s=10.0,
    max_subscriptions=20,
    max_publications=6,
    max_offers=3,
    max_calls_in_flight=6,
    max_queued_bytes=40_000,
    max_queued_request_bytes=5_000,
    max_queued_reply_bytes=20_000,
)

# Ends a frame; the byte before it tells the client, the kind of frame and how much time passes.
SEPARATOR = b"\xff"
CLIENT, BINARY, FLUSH, OTHER_CLIENTS, ADVANCE = 1, 2, 4, 8, 4

# In a binary frame it would end it: there two bytes stand for it, and two for the byte that begins these.
ESCAPES = ((b"\xfe", b"\xfe\x00"), (SEPARATOR, b"\xfe\x01"))

# One for each role, best first.
TOKENS = ("token-of-an-admin", "token-of-an-operator", "token-of-a-viewer")

# Two that may do everything, the second in the spelling of ROS 1; one that must authenticate; one that may look.
CLIENTS: tuple[tuple[str, Identity | None], ...] = (
    ("a", ANYONE),
    ("b", ANYONE),
    ("guest", None),
    ("viewer", Identity("viewer", Role.VIEW)),
)
ROS1 = "b"


class FindError(AssertionError):
    """Something that must not happen, in a sentence."""


class World:
    """Four clients on one graph with rosapi, in a time of their own."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.graph = Graph(REGISTRY, self.clock, self.clock, self.clock.call_later)
        RosApi(self.graph)
        self.topics = self.graph.topic_names.types()
        roles = ("admin", "operate", "view")
        tokens = {f"{role}_tokens": {role: token} for role, token in zip(roles, TOKENS, strict=True)}
        settings = AccessSettings.model_validate({"control": "shared", **tokens})
        self.access = Access(settings, self.clock, self.clock, lambda: None)
        turns = Turns(lambda callback: callback(), self.clock, AtOnce(), self.clock.call_later)
        self.gateway = Gateway(self.graph, self.access, AuthThrottle(self.clock), turns)
        self.sockets: dict[int, UnreadSocket] = {}
        self.clients = [self._enter(number) for number in range(len(CLIENTS))]

    def _enter(self, number: int) -> Client:
        name, identity = CLIENTS[number]
        session = Session(LIMITS, "ros1" if name == ROS1 else "ros2")
        socket = self.sockets[number] = UnreadSocket(name)
        return Client(ClientContext(Node(name, remote=True, identity=identity), session, self.gateway, socket, socket))

    def receive(self, control: int, frame: bytes) -> None:
        """Give one client one frame, and what follows from it."""
        number = control & CLIENT | (control & OTHER_CLIENTS) >> 2
        self.clock.advance(control >> ADVANCE)
        self.clients[number].receive_frame(frame_of(frame, binary=bool(control & BINARY)))
        for client in self.clients:
            for encoded in client.session.send_queue.take_unready():
                encode_or_log(encoded)
        if control & FLUSH:
            self._flush(self.clients[number])
        for left, client in enumerate(self.clients):
            if self.sockets[left].closed is not None or client.session.send_queue.overflowed:
                client.leave()
                self.clients[left] = self._enter(left)

    def _flush(self, client: Client) -> None:
        """Have one client read what is due."""
        while messages := client.session.data_to_send(self.clock()):
            for frame in (frame for encoded in messages for frame in encoded.frames):
                check_sent(frame)
        client.inbox.resume()

    def end(self) -> None:
        """Have all clients leave; nothing of them may stay."""
        for client in self.clients:
            client.leave()
        if self.graph.topic_names.types() != self.topics:
            raise FindError("topics of clients that have left are still there")
        self.clock.advance(1000.0)
        if self.clock.waiting:
            raise FindError(f"{self.clock.waiting} timers wait when everybody has left")


def check_sent(frame: Frame) -> None:
    """Read a frame as a client does: it is one operation, and its text is JSON as browsers read it."""
    try:
        if frame.text:
            # Refuses NaN and Infinity, as browsers do.
            value = orjson.loads(frame.data.decode("ascii"))
        else:
            value = decode_bson(frame.data) if is_document(frame.data) else cbor2.loads(frame.data)
    except Exception as error:
        raise FindError(f"a frame to a client cannot be read: {error!r}: {frame.data[:200]!r}") from error
    if not isinstance(value, dict) or not isinstance(value.get("op"), str):
        raise FindError(f"a frame to a client is no operation: {frame.data[:200]!r}")


@contextmanager
def logged_errors_raised() -> Iterator[None]:
    """Raise what the program logs with a traceback, where it carries on."""
    handler, log, found = logging.Handler(logging.ERROR), logging.getLogger("armbridge"), list[logging.LogRecord]()
    handler.emit = found.append
    level, log.level, propagate, log.propagate = log.level, logging.ERROR, log.propagate, False
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        log.propagate = propagate
    for record in (record for record in found if record.exc_info):
        raise FindError(record.getMessage()) from record.exc_info[1]


def run_world(data: bytes) -> None:
    """Play frames to four clients.

    Finds are exceptions, also those that are logged, frames to a client that it cannot read, and anything that stays
    when all have left.
    """
    with logged_errors_raised():
        world = World()
        for control, frame in parts_of(data):
            world.receive(control, frame)
        world.end()


def parts_of(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Cut bytes into frames, each with its control byte before it."""
    for part in data.split(SEPARATOR):
        if part:
            yield part[-1], part[:-1]


def escape(frame: bytes) -> bytes:
    """Return a binary frame as it stands in the bytes that are played."""
    for byte, escaped in ESCAPES:
        frame = frame.replace(byte, escaped)
    return frame


def frame_of(frame: bytes, *, binary: bool) -> str | bytes:
    """Return a frame as a client sends it: text, or the bytes that `escape` got."""
    if not binary:
        return frame.decode("utf-8", errors="replace")
    for byte, escaped in reversed(ESCAPES):
        frame = frame.replace(escaped, byte)
    return frame


def problem_of(data: bytes) -> str | None:
    """Return the kind of find that some bytes are, None for none: the error and where it was raised."""
    try:
        run_world(data)
    except Exception as error:  # noqa: BLE001 - every one is a find
        cause = error.__cause__ or error
        trace = cause.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        place = "" if trace is None else f" in {trace.tb_frame.f_code.co_qualname}, line {trace.tb_lineno}"
        return f"{type(error).__name__}: {str(error)[:300]}; {type(cause).__name__}{place}"
    return None


def cut_down(data: bytes) -> bytes:
    """Leave frames out, as long as the same kind of find remains."""
    kind, parts = kind_of(problem_of(data)), data.split(SEPARATOR)
    size = len(parts) // 2
    while size:
        start = 0
        while start < len(parts):
            shorter = parts[:start] + parts[start + size :]
            if kind_of(problem_of(SEPARATOR.join(shorter))) == kind:
                parts = shorter
            else:
                start += size
        size //= 2
    return SEPARATOR.join(parts)


def kind_of(problem: str | None) -> str:
    """Return what finds of one kind have in common: the error and where it was raised; empty for no find."""
    return "" if problem is None else problem.rpartition(";")[2]
