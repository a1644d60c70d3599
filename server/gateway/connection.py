"""Connection of one client: hands received messages to it and sends what it queues; and the traffic of all of them."""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from protocol.dialect import Dialect
from protocol.session import Session
from server.gateway.client import Client
from server.gateway.client_context import ClientContext, Gateway
from server.gateway.transport import Transport
from server.graph.permissions import Node, Role, display_name

log = logging.getLogger("armbridge.gateway")

# RFC 6455 7.4.1: the client broke a rule of ours, such as to read its replies.
POLICY_VIOLATION = 1008

# Time for a client that does not read to receive the reason why it is closed.
CLOSE_TIMEOUT_S = 1.0

# Time in which a client whose operations wait for its replies to be read has to read something [s].
UNREAD_TIMEOUT_S = 10.0

# How often it is looked within such a time whether a client has read anything.
LOOKS = 5

# Resolution of the loop's timers, which may ring a little early: they would ring again at once [s].
LEAST_DELAY_S = 0.001

# Time for what a client has sent before it left, and how often it is looked whether it is done [s].
LEAVE_TIMEOUT_S = 10.0
LEAVE_POLL_S = 0.005

# RFC 6455 5.5: size of the reason in a close frame [bytes].
MAX_REASON_BYTES = 123

# Time for a client to authenticate.
AUTH_TIMEOUT_S = 10.0

# Size of a message until then; messages that a client sends right behind its auth are read under this limit as well.
# All clients that may connect from one address hold 100 MB so.
MAX_UNKNOWN_BYTES = 131_072

# Viewers send nothing long, and a message of ten megabytes takes the server a second.
MAX_VIEW_BYTES = 1_048_576


def goals_end_with_client(query: Mapping[str, Sequence[str]], *, unless_asked: bool) -> bool:
    """Return True where a client's goals are cancelled when it leaves, as its query chooses by ``on_disconnect``."""
    return {"stop": True, "finish": False}.get(query.get("on_disconnect", [""])[-1], unless_asked)


class TrafficCounts(NamedTuple):
    """Traffic of one connection, or of all; a sent fragment counts as a message."""

    received_messages: int = 0
    received_bytes: int = 0
    sent_messages: int = 0
    sent_bytes: int = 0
    dropped_messages: int = 0


class Connection:
    """Connection of one client; its URL may override the end of its goals and the ROS version."""

    def __init__(self, transport: Transport, gateway: Gateway) -> None:
        self._transport = transport
        self.address, port = transport.peer
        place = f"{self.address}:{port}"
        self._closing: asyncio.Task[None] | None = None
        # Runs while anything waits for the client to read.
        self._watch: asyncio.TimerHandle | None = None
        # When the next throttled message leaves [s], infinity while none waits.
        self._timer: asyncio.TimerHandle | None = None
        self._timer_s = math.inf
        self._max_delay_s = gateway.limits.max_topic_delay_s
        query = transport.query
        self.node = node = Node(
            display_name(transport.identity, place),
            remote=True,
            takes_goals_along=goals_end_with_client(query, unless_asked=gateway.cancels_goals),
            identity=transport.identity,
            address=place,
        )
        dialect: Dialect = "ros1" if query.get("ros", [str(gateway.ros_version)]) == ["1"] else "ros2"
        session = Session(
            gateway.limits,
            dialect,
            gateway.budget,
            newest_only=not transport.framed,
            send_at_once=transport.send_at_once,
        )
        self._client = Client(ClientContext(node, session, gateway, transport, self))
        self._background = gateway.turns.background
        self._max_message_bytes = transport.max_message_bytes
        self.limit_messages()

    @property
    def queued_bytes(self) -> int:
        return self._client.session.send_queue.size_bytes

    def counts(self) -> TrafficCounts:
        transport, client = self._transport, self._client
        return TrafficCounts(
            received_messages=client.received_messages,
            received_bytes=transport.received_bytes,
            sent_messages=transport.sent_messages,
            sent_bytes=transport.sent_bytes,
            dropped_messages=client.session.dropped,
        )

    async def run(self) -> None:
        log.info("%s connected", self.node, extra=self._fields)
        waiting = None
        if self.node.identity is None:
            waiting = asyncio.get_running_loop().call_later(AUTH_TIMEOUT_S, self._check_authenticated)
        try:
            self._transport.start_delivery(self._client)
            await self._read()
            # Carry out what a client that leaves has sent before, unless it would have to read its replies first. A
            # client that has closed its own direction alone reads them.
            ends_s = time.monotonic() + LEAVE_TIMEOUT_S
            # Polled: nearly every client has nothing waiting when it leaves.
            while self._is_unfinished and time.monotonic() < ends_s:  # noqa: ASYNC110
                await asyncio.sleep(LEAVE_POLL_S)
        finally:
            if waiting is not None:
                waiting.cancel()
            for timer in (self._watch, self._timer):
                if timer is not None:
                    timer.cancel()
            self._transport.stop_delivery()
            self._client.leave()
            self._client.session.send_queue.close()

    @property
    def _is_unfinished(self) -> bool:
        session, waits = self._client.session, not self._client.inbox.empty
        if self._transport.is_open:
            return waits or session.send_queue.reply_bytes > 0
        return waits and not session.congested

    async def _read(self) -> None:
        try:
            await self._transport.read_to_end()
        except ConnectionResetError:
            log.info("%s left without a word", self.node, extra=self._fields)
        except ConnectionError as closed:
            log.warning("%s: connection closed: %s", self.node, closed, extra=self._fields)
        else:
            log.info("%s left", self.node, extra=self._fields)

    @property
    def _fields(self) -> dict[str, str]:
        return {"client": str(self.node)}

    def wake(self) -> None:
        """Send the messages that are due as the socket takes them; disconnect a client that reads no replies."""
        session = self._client.session
        for encoded in session.send_queue.take_unready():
            self._background.encode(encoded, self.wake)
        if session.send_queue.overflowed:
            self._give_up()
            return
        if self._send_later():
            return
        self._flush()
        if session.send_queue.size_bytes and not self._send_later() and self._watch is None:
            self._expect_reading(time.monotonic())

    def _send_later(self) -> bool:
        """Have all that waits sent at its time; False where some may leave now, or is still to be encoded.

        By a timer: throttled topics wait all the time, and a task that waits costs more than the sending itself.
        """
        now_s = time.monotonic()
        due_s = self._client.session.send_queue.next_due(now_s)
        if due_s is None or due_s <= now_s:
            return False
        if due_s < self._timer_s:
            if self._timer is not None:
                self._timer.cancel()
            self._timer_s = due_s
            delay_s = max(due_s - now_s, LEAST_DELAY_S)
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._send_throttled)
        return True

    def _send_throttled(self) -> None:
        self._timer_s = math.inf
        self.wake()

    def _expect_reading(self, since_s: float) -> None:
        delay_s = min(self._max_delay_s, UNREAD_TIMEOUT_S) / LOOKS
        taken_bytes = self._transport.taken_bytes
        self._watch = asyncio.get_running_loop().call_later(delay_s, self._check_reading, taken_bytes, since_s)

    def _check_reading(self, taken_bytes: int, since_s: float) -> None:
        """Drop what waits for too long, if the client stands still; disconnect it if it does not read its replies."""
        self._watch = None
        # A starved loop may look here before it hears that a message has been encoded.
        # The client could not read that one yet.
        self._flush()
        session, now_s = self._client.session, time.monotonic()
        if self._transport.taken_bytes > taken_bytes:
            since_s = now_s
        if now_s - since_s >= self._max_delay_s:
            session.send_queue.drop_late(now_s)
        if session.send_queue.overflowed or (session.congested and now_s - since_s >= UNREAD_TIMEOUT_S):
            self._give_up()
        elif session.send_queue.size_bytes:
            self._expect_reading(since_s)

    def _give_up(self) -> None:
        if self._closing is None:
            log.warning("%s: does not read its replies; closing", self.node)
            self.disconnect("replies are not read")

    def limit_messages(self) -> None:
        """Set the size of a message that the client may send, by its role."""
        identity, limit_bytes = self.node.identity, self._max_message_bytes
        if identity is None:
            limit_bytes = MAX_UNKNOWN_BYTES
        elif identity.role < Role.OPERATE:
            limit_bytes = min(MAX_VIEW_BYTES, limit_bytes)
        self._transport.max_message_bytes = limit_bytes

    def _check_authenticated(self) -> None:
        if self.node.identity is None and self._closing is None:
            log.warning("%s: authentication timed out after %g s; closing", self.node, AUTH_TIMEOUT_S)
            self.disconnect(f"the op auth is wanted within {AUTH_TIMEOUT_S:g} s")

    def disconnect(self, reason: str) -> None:
        """End the connection with a reason, after which nothing of the client is carried out."""
        self._client.inbox.close()
        if self._closing is None:
            self._closing = asyncio.create_task(self._close(reason), name=f"close {self.node}")

    async def _close(self, reason: str) -> None:
        """Close the connection with a reason, and end it even if the client reads nothing."""
        short = reason.encode()[:MAX_REASON_BYTES].decode(errors="ignore")
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._transport.close(POLICY_VIOLATION, short), CLOSE_TIMEOUT_S)
        self._transport.abort()

    def _flush(self) -> None:
        """Send the messages that are due while the socket takes them without waiting."""
        while self._transport.takes_more:
            messages = self._client.session.data_to_send(time.monotonic())
            if not messages:
                return
            self._transport.send_all(messages)
            self._client.inbox.resume()


class Traffic:
    """Traffic of all connections, those that have ended included; it is added up when it is asked for."""

    def __init__(self) -> None:
        self.connections = 0
        self._open: set[Connection] = set()
        self._ended = TrafficCounts()

    @property
    def clients(self) -> int:
        return len(self._open)

    def add(self, connection: Connection) -> None:
        self.connections += 1
        self._open.add(connection)

    def remove(self, connection: Connection) -> None:
        """Remove a connection that has ended; its traffic stays counted."""
        self._open.discard(connection)
        self._ended = _sum([self._ended, connection.counts()])

    def counts(self) -> TrafficCounts:
        return _sum([self._ended, *(connection.counts() for connection in self._open)])

    def queued_bytes(self) -> int:
        """Return the bytes that wait for all clients."""
        return sum(connection.queued_bytes for connection in self._open)


def _sum(counts: list[TrafficCounts]) -> TrafficCounts:
    return TrafficCounts(*map(sum, zip(*counts, strict=True)))
