"""One goal of an action on its way, from the goal to its one result."""

from __future__ import annotations

import enum
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from protocol.errors import MessageError
from server.interfaces import Interfaces
from server.node import Node
from server.pending import Pending


class GoalStatus(enum.IntEnum):
    """How a goal ended: values of action_msgs/GoalStatus."""

    # The goal was never taken on.
    UNKNOWN = 0
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@dataclass(frozen=True)
class Result:
    """The end of a goal.

    Attributes:
        ok: whether there is a result message.
        status: a value of `GoalStatus`.
        values: the complete result message; without one a sentence, or what the provider gave.
    """

    ok: bool
    status: int
    values: Any


class Goal(Pending[Result]):
    """A goal that its provider is to end with :meth:`finish` or :meth:`fail`; only the first end counts.

    Args:
        action: fully qualified name.
        type_name: canonical name of the action's type.
        request: the complete goal message.
        interfaces: to complete feedback and result.
        on_feedback: gets the complete feedback messages, None when nobody wants them.
        sender: who sent it.

    Attributes:
        action: as given.
        type_name: as given.
        request: as given.
        sender: as given.
        goal_id: sixteen octets that no other goal has.
        cancel_requested: whether somebody has asked for the end of the goal.
    """

    def __init__(
        self,
        action: str,
        type_name: str,
        request: dict[str, Any],
        interfaces: Interfaces,
        on_feedback: Callable[[dict[str, Any]], None] | None,
        sender: Node,
    ) -> None:
        super().__init__()
        self.sender = sender
        self.action = action
        self.type_name = type_name
        self.request = request
        self.goal_id = uuid.uuid4().bytes
        self.cancel_requested = False
        self._interfaces = interfaces
        self._on_feedback = on_feedback
        self._when_canceled: list[Callable[[], None]] = []

    def feedback(self, values: object) -> None:
        """Tell how the goal goes; what the message leaves out gets its default.

        Raises:
            MessageError: the values do not fit the action's type.
        """
        completed = self._interfaces.complete(f"{self.type_name}_Feedback", values)
        if self._on_feedback is not None and not self.ended:
            self._on_feedback(completed)

    def finish(self, status: GoalStatus, values: object) -> None:
        """End the goal with a result message; what it leaves out gets its default.

        Raises:
            MessageError: the values do not fit the action's type; the sender has been told that the goal failed.
        """
        try:
            completed = self._interfaces.complete(f"{self.type_name}_Result", values)
        except MessageError as error:
            self.fail(f"Action {self.action} gave a result that does not fit {self.type_name}: {error}")
            raise
        self._end(Result(ok=True, status=status, values=completed))

    def fail(self, values: object, status: int = GoalStatus.ABORTED) -> None:
        """End the goal without a result message, with a sentence or with what the provider gave."""
        self._end(Result(ok=False, status=status, values=values))

    def when_canceled(self, callback: Callable[[], None]) -> None:
        """Have this called when somebody asks for the end of the goal; at once when somebody has."""
        self._when_canceled.append(callback)
        if self.cancel_requested:
            callback()

    def cancel(self) -> None:
        """Ask the provider to end the goal, which still ends as the provider says."""
        if self.cancel_requested or self.ended:
            return
        self.cancel_requested = True
        for callback in self._when_canceled:
            callback()

    def forget_sender(self) -> None:
        """Tell nobody of feedback any more, for the one who wanted it has left."""
        self._on_feedback = None
