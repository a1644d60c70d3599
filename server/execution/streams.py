"""Streams of messages that move the arm, such as sticks and trajectories, which a stop ends until they pause."""

import asyncio

from planners.problem import MoveItErrorCode
from server.arrival import arrival_epoch, is_stopped
from server.errors import refused

# A stream that was stopped has ended when the topic is silent for this time: clients publish at 10 Hz and more.
STREAM_PAUSE_S = 0.5

# Parts of a silence. A standstill ends one of them at most, so that at least four fifths of a silence are real.
SILENCE_PARTS = 5


class Silence:
    """Wait for the silence of a stream of messages, in parts that the event loop waits for one after the other.

    By a clock, a standstill of the server would count as silence, because the messages of that time are not read yet: a
    stick that was held on all the while moved the arm again after a stop. A standstill counts as one part.
    """

    def __init__(self, pause_s: float) -> None:
        self._part_s = pause_s / SILENCE_PARTS
        self._parts_left = 0
        self._timer: asyncio.TimerHandle | None = None

    def take_message(self) -> bool:
        """Note a message; return True for the first, and for the first after a silence."""
        if self._timer is not None:
            self._timer.cancel()
        over, self._parts_left = not self._parts_left, SILENCE_PARTS
        self._wait()
        return over

    def _wait(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._part_s, self._pass)

    def _pass(self) -> None:
        self._timer, self._parts_left = None, self._parts_left - 1
        if self._parts_left:
            self._wait()


class MessageStream:
    """Stream of messages on a topic that move the arm, which a stop ends until the topic is silent for a moment."""

    def __init__(self, topic: str, pause_s: float = STREAM_PAUSE_S) -> None:
        self._topic, self._pause_s, self._silence = topic, pause_s, Silence(pause_s)
        self._epoch = 0  # stop epoch of the stream's first message

    def check(self, last_stop: int) -> None:
        """Take a message; raise RefusedError where the arm's last stop has ended the stream."""
        if self._silence.take_message():
            self._epoch = arrival_epoch()
        if is_stopped(last_stop, self._epoch):
            text = f"the arm was stopped: publish nothing on {self._topic} for {self._pause_s:g} s to move it again"
            raise refused(MoveItErrorCode.PREEMPTED, text)
