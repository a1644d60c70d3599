"""Which commands may steer the arm: from whom, of which kind, and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from server.moveit.servo.ownership import Ownership


class CommandType(IntEnum):
    """Values of moveit_msgs/ServoCommandType."""

    JOINT_JOG = 0
    TWIST = 1
    POSE = 2


@dataclass(frozen=True)
class Refusal:
    """Why a command is not followed; ``of_owner`` tells whether by who steers, whom the status is for."""

    message: str
    of_owner: bool = True


class Gate:
    """Lets commands through.

    Args:
        present: whether a client is still there.
        timeout_s: a stick counts as let go of after a silence of this time [s].
        busy: why the arm cannot be steered now, or an empty text.

    Attributes:
        paused: whether no command is let through.
    """

    def __init__(self, present: Callable[[object], bool], timeout_s: float, busy: Callable[[], str]) -> None:
        self._ownership = Ownership(present)
        self._timeout_s = timeout_s
        self._busy = busy
        self._selected: CommandType | None = None
        self._heard_s = -float("inf")
        self._interrupted = ""
        self.paused = False

    def select(self, kind: CommandType) -> None:
        """Let through only commands of a kind, until who steers lets go."""
        self._selected = kind

    def interrupt(self, reason: str) -> None:
        """Let nothing through until the stick was let go of: somebody else has stopped the arm."""
        self._interrupted = reason

    def reset(self) -> None:
        """Forget that there was an interruption."""
        self._interrupted = ""

    def refusal(self, client: object, kind: CommandType, now_s: float) -> Refusal | None:
        """Why a command may not steer the arm; None when it may.

        Args:
            client: who sends it.
            kind: of the command.
            now_s: monotonic time [s].
        """
        owner = self._ownership.owner(now_s)
        if owner is None and self._heard_s > -float("inf"):
            # What the last one had selected does not bind the next.
            self._selected, self._heard_s = None, -float("inf")
        if not self._ownership.take(client, now_s):
            return Refusal(f"{client} cannot steer the arm: {owner} does", of_owner=False)
        silence_s, self._heard_s = now_s - self._heard_s, now_s
        if silence_s > self._timeout_s:
            self._interrupted = ""
        message = self._closed(kind)
        return Refusal(message) if message else None

    def _closed(self, kind: CommandType) -> str:
        if self.paused:
            return "servo is paused: unpause it by the service /servo_node/pause_servo or start_servo"
        if self._selected is not None and kind is not self._selected:
            return f"the command type {self._selected.name} was selected; this is a {kind.name} command"
        if self._interrupted:
            return f"{self._interrupted}; let go for {self._timeout_s:g} s to steer again"
        return self._busy()
