"""Turns of the clients with work that waits, one after the other; and the threads for what takes longer than a turn.

Everything in the server waits while an operation is carried out. So a client gets half a millisecond at a time, and all
clients together a millisecond; then the event loop looks at its sockets again. A thread takes the steps that a large
message makes longer.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

from protocol.errors import ProtocolError
from protocol.publication import EncodedMessage
from server.timers import CallLater, call_later

if TYPE_CHECKING:
    from server.gateway.inbox import Inbox

log = logging.getLogger("armbridge.gateway")

# Time of one client, and of all clients, before the event loop serves its sockets again [s].
TURN_S = 0.0005
ROUND_S = 0.001

# Two large messages at a time: behind each further thread the event loop would wait for the interpreter's lock.
THREADS = 2

# Bounds of one client's inbox [bytes]: several of the largest trajectories that clients send. Beyond a total of all
# inboxes, each client has only what a page sends when it opens.
MAX_WAITING_BYTES = 16_000_000
MAX_SERVER_WAITING_BYTES = 64_000_000
LEAST_WAITING_BYTES = 262_144

Done = TypeVar("Done")


class Turns:
    """Turns of all clients of a server, and the threads and the memory that they share."""

    def __init__(
        self,
        call_soon: Callable[[Callable[[], object]], object],
        clock: Callable[[], float],
        background: MessageThreads,
        call_later: CallLater = call_later,
    ) -> None:
        self.call_soon = call_soon
        self.clock = clock
        self.background = background
        self.call_later = call_later
        self.waiting_bytes = 0
        # In order of their turns.
        self._waiting: dict[Inbox, None] = {}
        # Until when work that has just come may be done at once; None before any has come in this turn of the loop.
        self._round_ends_s: float | None = None

    @property
    def limit_bytes(self) -> int:
        """Bytes that one client's inbox may have."""
        return MAX_WAITING_BYTES if self.waiting_bytes <= MAX_SERVER_WAITING_BYTES else LEAST_WAITING_BYTES

    def add(self, inbox: Inbox) -> None:
        """Give a client a turn, behind those that wait already."""
        if inbox not in self._waiting:
            self._waiting[inbox] = None
            if len(self._waiting) == 1:
                self.call_soon(self._play_round)

    def remove(self, inbox: Inbox) -> None:
        self._waiting.pop(inbox, None)

    def until_s(self) -> float | None:
        """Return until when work that has just come may be done at once [s]; None when it has to wait for its turn."""
        now_s, ends_s = self.clock(), self._round_ends_s
        if ends_s is None:
            ends_s = self._round_ends_s = now_s + ROUND_S
            self.call_soon(self._begin_round)
        return min(ends_s, now_s + TURN_S) if now_s <= ends_s else None

    def _begin_round(self) -> None:
        self._round_ends_s = None

    def _play_round(self) -> None:
        ends_s = self.clock() + ROUND_S
        while self._waiting:
            inbox = next(iter(self._waiting))
            del self._waiting[inbox]
            if inbox.work(min(ends_s, self.clock() + TURN_S)):
                self._waiting[inbox] = None
            if self.clock() >= ends_s:
                break
        if self._waiting:
            self.call_soon(self._play_round)


class MessageThreads:
    """Threads for the large messages of a gateway's clients; its methods are called in the event loop alone."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(THREADS, thread_name_prefix="armbridge-large")
        # Messages that are being encoded, with those who wait for them.
        self._encoding: dict[EncodedMessage, list[Callable[[], None]]] = {}
        self._closed = False

    def run(self, job: Callable[[], Done], done: Callable[[Done, float], None], failed: Callable[[], None]) -> None:
        """Run a job; then call ``done`` with its result and processor time [s], or ``failed``, in the event loop."""

        def timed() -> tuple[Done, float]:
            began_s = time.thread_time()
            result = job()
            return result, time.thread_time() - began_s

        def finish(future: asyncio.Future[tuple[Done, float]]) -> None:
            error = None if future.cancelled() else future.exception()
            if self._closed:
                return
            if error is None:
                done(*future.result())
            else:
                log.error("work on a large message failed", exc_info=error)
                failed()

        if not self._closed:
            asyncio.get_running_loop().run_in_executor(self._executor, timed).add_done_callback(finish)

    def encode(self, encoded: EncodedMessage, ready: Callable[[], None]) -> None:
        """Encode a message once, for however many calls; ``ready`` is called in the event loop, also on failure."""
        waiting = self._encoding.get(encoded)
        if waiting is not None:
            waiting.append(ready)
            return
        self._encoding[encoded] = [ready]

        def end() -> None:
            for each in self._encoding.pop(encoded):
                each()

        self.run(lambda: encode_or_log(encoded), lambda _result, _cost_s: end(), end)

    def close(self) -> None:
        """Begin no further job; nobody is called at the end of a running one."""
        self._closed = True
        self._executor.shutdown(wait=False, cancel_futures=True)


def encode_or_log(encoded: EncodedMessage) -> None:
    """Encode a message, or leave it out with a log line."""
    try:
        encoded.encode()
    except ProtocolError as error:
        log.warning("a message is not delivered: %s", error)
