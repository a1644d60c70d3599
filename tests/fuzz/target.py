"""What a fuzzer feeds: one session, or two clients on one graph, which get frames cut out of any bytes."""

from __future__ import annotations

from protocol.limits import Limits
from protocol.operations import Operation
from protocol.registry import Registry
from protocol.session import Packed, Refusal, Session
from server.access.authorization import unlimited
from server.gateway.client import Client
from server.gateway.client_auth import AuthContext
from server.gateway.client_context import ClientContext
from server.gateway.inbox import Scheduling
from server.gateway.turns import Turns, encode_or_log
from server.graph.node import Node
from server.graph.topics import Graph
from tests.helpers.gateway import AtOnce, UnreadSocket

REGISTRY = Registry.load()

# Small limits are reached by small inputs.
LIMITS = Limits(max_subscriptions=20, max_publications=20, max_queued_bytes=20_000, max_queued_reply_bytes=20_000)

# Ends a frame; the byte before it chooses the client, the kind of frame and how much time passes.
SEPARATOR = b"\xff"


class NoTimer:
    """Time does not run by itself here."""

    def cancel(self) -> None:
        """Nothing to cancel."""


def run_session(data: bytes) -> None:
    """Play frames to a session alone; any exception is a find."""
    session = Session(LIMITS)
    now_s = 0.0
    for part in data.split(SEPARATOR):
        if part:
            control, frame = part[-1], part[:-1]
            now_s += control >> 4
            for item in session.receive_frame(_frame(frame, binary=bool(control & 2)), now_s):
                read = session.unpack(item) if isinstance(item, Packed) else item
                assert isinstance(read, Operation | Refusal)


def run_world(data: bytes) -> None:
    """Play frames to two clients; any exception is a find, and so is a client whose queue outgrows its limits."""
    now_s = 0.0
    graph = Graph(REGISTRY, lambda: now_s, lambda: now_s, lambda _delay_s, _action: NoTimer())
    nodes = [Node(name, remote=True) for name in ("a", "b")]
    contexts = [ClientContext(node, graph, Session(LIMITS), lambda: now_s, lambda: None) for node in nodes]
    scheduling = Scheduling(
        Turns(lambda callback: callback(), lambda: now_s), AtOnce(), lambda _delay_s, _action: NoTimer()
    )
    clients = [Client(context, AuthContext(unlimited()), scheduling, UnreadSocket()) for context in contexts]
    for part in data.split(SEPARATOR):
        if not part:
            continue
        control, frame = part[-1], part[:-1]
        now_s += control >> 4
        clients[control & 1].receive_frame(_frame(frame, binary=bool(control & 2)))
        client = clients[control & 1]
        for encoded in client.session.take_unready():
            encode_or_log(encoded)
        if control & 4:
            queued = sum(one.size_bytes for one in client.session.data_to_send(now_s))
            client.inbox.resume()
            assert queued <= 2 * (LIMITS.max_queued_bytes + LIMITS.max_queued_reply_bytes) + len(data) * 8
    for client in clients:
        client.leave()
    assert graph.topic_types() == {}


def _frame(frame: bytes, *, binary: bool) -> str | bytes:
    if binary:
        return frame
    return frame.decode("utf-8", errors="replace")
