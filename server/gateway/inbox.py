"""Inbox of one client: frames and operations that wait for their turn, in order; stops have a lane of their own.

A frame that arrives while nothing waits is carried out at once, as far as the client's turn reaches. The rest waits,
and while much waits the client's socket is not read. Long frames are read, and large messages completed, by a thread.
Every frame keeps the stop epoch in which it arrived, so that an operation which a stop has overtaken moves nothing.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from protocol.codecs.json import is_light
from protocol.operations import Operation
from protocol.session import Packed, Refusal
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import is_cancel, is_stop
from server.arrival import arrived_in
from server.gateway.client_context import ClientContext
from server.graph.message_types import PostponedError, ReceivedMessage

if TYPE_CHECKING:
    from server.gateway.client import Client

log = logging.getLogger("armbridge.gateway")

# Frames of this size and more are read by a thread: a thousand operations in a frame of 40 kB take 7 ms.
LONG_FRAME_BYTES = 16_384

# Operations in one client's inbox beyond which its socket is not read, as beyond `Turns.limit_bytes`. A stop
# behind them waits for its turn.
MAX_WAITING = 4_096

# Period of the lane for stops after a first stop, and its share of each period [s]: a flood of stops must not hold up
# other clients.
STOP_PERIOD_S = 0.02
STOP_TURN_S = 0.001

# Time for which a client's work waits while its socket delivers more, so that a stop behind a burst is found soon [s].
READ_AHEAD_S = 0.02

# Messages of different types for which one message is completed in the background, before it is given up.
MAX_COMPLETIONS = 3


@dataclass(slots=True, eq=False)
class Waiting:
    """Frame, or one of its operations, on its way to be carried out; ``light`` if that is quick, however long it is."""

    item: str | bytes | Operation | Refusal | Packed
    size_bytes: int
    epoch: int
    repeated: bool = False
    message: ReceivedMessage | None = None
    completions: int = 0
    light: bool = False


class Inbox:
    """Frames and operations of one client that wait."""

    def __init__(self, client: Client, context: ClientContext) -> None:
        self.client = client
        self._session = context.session
        self._graph = context.graph
        self._turns = context.gateway.turns
        self._transport = context.transport
        self._clock = context.clock
        self._waiting: deque[Waiting] = deque()
        self._waiting_bytes = 0
        # True while a thread works on the item that was the first.
        self._in_progress = False
        self._holds_reader = False
        # Set by each frame that waits, and the time until which the work waits for further frames.
        self._arrived = False
        self._read_ahead_until_s = 0.0
        # Set by a frame that took longer than its turn: the next one waits, so that a stop behind it is found soon.
        self._overran = False
        # Time of the next job for a thread: a client has the threads for half of the time at most.
        self._next_job_s = 0.0
        # Stops and cancels that came faster than their lane allows.
        self._stops: deque[Waiting] = deque()
        self._next_stop_s = 0.0
        self._closed = False

    @property
    def empty(self) -> bool:
        return not self._waiting and not self._in_progress and not self._stops

    def close(self) -> None:
        self._closed = True
        self._waiting.clear()
        self._stops.clear()
        self._count(-self._waiting_bytes)
        self._turns.remove(self)

    def resume(self) -> None:
        """Go on, after the client has read its replies."""
        if self._may_go_on():
            self._turns.add(self)

    def receive_frame(self, frame: str | bytes, epoch: int | None = None) -> None:
        """Take a frame that arrived in a stop epoch, None for the present one; nothing in it can raise."""
        if self._closed:
            return
        at_once = self.empty and not self._overran and not self._session.congested
        until_s = self._turns.until_s() if at_once else None
        received = Waiting(frame, len(frame), STOP_EPOCHS.present if epoch is None else epoch)
        if until_s is not None and len(frame) >= LONG_FRAME_BYTES:
            received.light = isinstance(frame, str) and self.client.identified and is_light(frame)
            if not received.light:
                until_s = None
        if until_s is None:
            self._add_frame(received, frame)
        elif received.light or not self._published(received):
            self._begin(received, frame, until_s)
            self._overran = self._clock() > until_s

    def work(self, until_s: float) -> bool:
        """Carry out what waits until a time; return True when there is more to do now."""
        if self._arrived and self._clock() < self._read_ahead_until_s and not self._holds_reader:
            self._arrived = False
            self._turns.call_soon(self.resume)
            return False
        while self._may_go_on():
            self._take_step()
            if self._clock() >= until_s:
                break
        self._hold_or_release()
        return self._may_go_on()

    def _may_go_on(self) -> bool:
        return bool(self._waiting) and not self._in_progress and not self._session.congested

    def _count(self, size_bytes: int) -> None:
        self._waiting_bytes += size_bytes
        self._turns.waiting_bytes += size_bytes

    def _hold_or_release(self) -> None:
        """Leave the client's socket unread while much waits."""
        count = len(self._waiting) + len(self._stops)
        full = count > MAX_WAITING or self._waiting_bytes > self._turns.limit_bytes
        if full and not self._holds_reader:
            self._transport.hold_reading()
        elif self._holds_reader and not full:
            self._transport.release_reading()
        self._holds_reader = full

    def _published(self, waiting: Waiting) -> bool:
        """Publish a frame's message in the quick way, which dates it to the present stop epoch; False for others."""
        frame, present = waiting.item, waiting.epoch == STOP_EPOCHS.present
        return present and isinstance(frame, str) and self.client.publish_strictly(frame)

    def _begin(self, received: Waiting, frame: str | bytes, until_s: float) -> None:
        items = self.client.read(frame)
        if len(items) == 1 and not isinstance(items[0], Packed):
            # The quick way of nearly every frame.
            received.item = items[0]
            self._carry_out(received, items[0])
            return
        self._put_first(_read_of(received, items))
        if self.work(until_s):
            self._turns.add(self)

    def _add(self, waiting: Waiting) -> None:
        if not self._waiting:
            self._read_ahead_until_s = self._clock() + READ_AHEAD_S
        self._arrived, self._overran = True, False
        self._waiting.append(waiting)
        self._count(waiting.size_bytes)
        self._hold_or_release()
        if not self._in_progress:
            self._turns.add(self)

    def _put_first(self, read: Sequence[Waiting]) -> None:
        """Let operations of one frame wait before all others; stops among them go ahead."""
        left = [each for each in read if not (self.client.identified and self._take_ahead(each))]
        self._waiting.extendleft(reversed(left))
        self._count(sum(each.size_bytes for each in left))

    def _add_frame(self, received: Waiting, frame: str | bytes) -> None:
        """Let a frame wait unread; a stop in a frame of its own goes ahead."""
        urgent = len(frame) < LONG_FRAME_BYTES and self.client.identified and _may_be_urgent(frame)
        if urgent and (operation := self._session.peek(frame)):
            ahead = replace(received, item=operation)
            if self._take_ahead(ahead):
                return
            if ahead.repeated:
                self._add(ahead)
                return
        self._add(received)

    # The lane for stops.

    def _take_ahead(self, waiting: Waiting) -> bool:
        """Take a stop or a cancel into its lane; return False for any other operation, which waits for its turn."""
        operation = waiting.item
        if waiting.repeated or not isinstance(operation, Operation):
            return False
        # The goal of a cancel may wait behind other operations of this client, so a cancel is repeated in its turn.
        cancels = is_cancel(operation, self._graph)
        if not cancels and not is_stop(operation, self._graph):
            return False
        # Its frame may be long; its message is not, and is completed at once.
        ahead = replace(waiting, size_bytes=0)
        if self._stops or self._clock() < self._next_stop_s:
            if not self._stops:
                self._turns.call_later(self._next_stop_s - self._clock(), self._work_off_stops)
            self._stops.append(ahead)
            self._hold_or_release()
        else:
            self._next_stop_s = self._clock() + STOP_PERIOD_S
            self._carry_out(ahead, operation)
        waiting.repeated = cancels
        return not cancels

    def _work_off_stops(self) -> None:
        if self._closed:
            return
        until_s = self._clock() + STOP_TURN_S
        while self._stops and self._clock() < until_s:
            stop = self._stops.popleft()
            if isinstance(stop.item, Operation):
                self._carry_out(stop, stop.item)
        self._next_stop_s = self._clock() + STOP_PERIOD_S
        if self._stops:
            self._turns.call_later(STOP_PERIOD_S, self._work_off_stops)
        self._hold_or_release()

    def _take_step(self) -> None:
        first = self._waiting.popleft()
        self._count(-first.size_bytes)
        item = first.item
        if isinstance(item, str | bytes):
            if len(item) >= LONG_FRAME_BYTES and self.client.identified:
                self._run(lambda: self._session.receive_frame(item, self._clock()), first)
            elif not self._published(first):
                self._put_first(_read_of(first, self.client.read(item)))
        elif isinstance(item, Packed):
            self._run(lambda: [self._session.unpack(item)], first)
        elif first.repeated and isinstance(item, Operation):
            self.client.repeat(item)
        else:
            self._carry_out(first, item)

    def _carry_out(self, waiting: Waiting, item: Operation | Refusal) -> None:
        try:
            with arrived_in(waiting.epoch):
                self.client.carry_out(item, waiting)
        except PostponedError as postponed:
            self._complete(waiting, postponed)

    def _complete(self, waiting: Waiting, postponed: PostponedError) -> None:
        """Complete the message of an operation in the background, and carry the operation out next."""
        waiting.message = postponed.message
        waiting.completions += 1
        if self._in_progress or waiting.completions > MAX_COMPLETIONS:
            # A stop with a large message while a thread is busy, or a topic that has had another type each time.
            log.warning("an operation is given up: its message is too large")
            return

        def complete() -> None:
            postponed.message.complete(self._graph.message_types, postponed.type_name)

        self._run(complete, waiting)

    def _run(self, job: Callable[[], Sequence[Operation | Refusal | Packed] | None], waiting: Waiting) -> None:
        """Have a thread work on the first item; put it, or the operations read from it, before all that waits."""
        self._in_progress = True

        def attempt() -> Sequence[Operation | Refusal | Packed] | MemoryError | None:
            try:
                return job()
            except MemoryError:
                # A new error: the traceback of the first keeps the message.
                return MemoryError()

        def finish(result: Sequence[Operation | Refusal | Packed] | MemoryError | None, cost_s: float) -> None:
            self._in_progress = False
            self._next_job_s = self._clock() + cost_s
            if self._closed:
                return
            if isinstance(result, MemoryError):
                self._transport.end_out_of_memory()
            else:
                self._put_first([waiting] if result is None else _read_of(waiting, result))
                self.resume()

        def give_up() -> None:
            self._in_progress = False
            self.resume()

        def begin() -> None:
            if not self._closed:
                self._turns.background.run(attempt, finish, give_up)

        wait_s = self._next_job_s - self._clock()
        if wait_s > 0:
            self._turns.call_later(wait_s, begin)
        else:
            begin()


def _may_be_urgent(frame: str | bytes) -> bool:
    """Look for the words in the names of all stops and cancels, in a hundredth of the time that reading takes."""
    if isinstance(frame, str):
        return "stop" in frame or "cancel" in frame
    return b"stop" in frame or b"cancel" in frame


def _read_of(frame: Waiting, items: Sequence[Operation | Refusal | Packed]) -> list[Waiting]:
    return [Waiting(item, frame.size_bytes, frame.epoch) for item in items]
