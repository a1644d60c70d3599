"""The goals of one action as actionlib of ROS 1 keeps account of them: ids, stamps, statuses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, TypeAlias

from protocol.messages import Stamp
from server.action_goals import GoalStatus

GoalId: TypeAlias = Mapping[str, Any]

# actionlib's status_list_timeout: for so long the status of a goal that has ended is still told.
ENDED_KEPT_S = 5.0

# Far more than anybody waits for; further goals are rejected.
MAX_GOALS = 100

ZERO = Stamp(0, 0)


class Status(IntEnum):
    """Values of actionlib_msgs/GoalStatus that are told here."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6


STATUS_OF_END = {GoalStatus.SUCCEEDED: Status.SUCCEEDED, GoalStatus.CANCELED: Status.PREEMPTED}


@dataclass(frozen=True)
class Tracked:
    """A goal.

    Attributes:
        goal_id: its actionlib_msgs/GoalID, complete.
        status: where it is.
        text: a sentence about that.
        ended_s: when it ended [s], None while it has not.
    """

    goal_id: GoalId
    status: Status = Status.PENDING
    text: str = ""
    ended_s: float | None = None

    @property
    def key(self) -> str:
        """Its id, which no other goal of the action has."""
        return str(self.goal_id["id"])

    def message(self) -> dict[str, Any]:
        """Its actionlib_msgs/GoalStatus."""
        return {"goal_id": self.goal_id, "status": int(self.status), "text": self.text}


class TrackedGoals:
    """All goals of one action that have not been forgotten.

    Args:
        action: name of the action, for the ids of goals that have none.
    """

    def __init__(self, action: str) -> None:
        self._action = action
        self._goals: dict[str, Tracked] = {}
        self._count = 0

    @property
    def full(self) -> bool:
        """Whether no more goals can be taken on."""
        return sum(goal.ended_s is None for goal in self._goals.values()) >= MAX_GOALS

    def add(self, goal_id: GoalId, now: Stamp) -> Tracked | None:
        """Take a goal on.

        Args:
            goal_id: as its client gave it; without an id it gets one, without a stamp that of now.
            now: wall-clock time.

        Returns:
            The goal; None when its id is known already.
        """
        stamp = _stamp(goal_id) if _stamp(goal_id) != ZERO else now
        self._count += 1
        name = goal_id["id"] or f"{self._action}-{self._count}-{stamp.sec}.{stamp.nanosec:09d}"
        if name in self._goals:
            return None
        goal = self._goals[name] = Tracked({"stamp": stamp.as_message(), "id": name})
        return goal

    def on_its_way(self, key: str) -> Tracked | None:
        """A goal that has not ended."""
        goal = self._goals.get(key)
        return None if goal is None or goal.ended_s is not None else goal

    def update(self, key: str, status: Status, text: str = "") -> Tracked | None:
        """Tell how a goal goes; returns it, or None when it is not on its way."""
        goal = self.on_its_way(key)
        if goal is None:
            return None
        self._goals[key] = replace(goal, status=status, text=text or goal.text)
        return self._goals[key]

    def end(self, key: str, status: Status, text: str, now_s: float) -> Tracked | None:
        """Tell how a goal has ended, at a monotonic time [s]; returns as :meth:`update`."""
        goal = self.update(key, status, text)
        if goal is not None:
            goal = self._goals[key] = replace(goal, ended_s=now_s)
        return goal

    def to_cancel(self, goal_id: GoalId) -> list[str]:
        """Which goals a message on the topic ``cancel`` means.

        All of them when it says nothing; else that of its id, and all that are no younger than its stamp.
        """
        stamp, name = _stamp(goal_id), goal_id["id"]
        everything = not name and stamp == ZERO
        return [
            key
            for key, goal in self._goals.items()
            if goal.ended_s is None and (everything or key == name or ZERO < _stamp(goal.goal_id) <= stamp)
        ]

    def forget(self, now_s: float) -> None:
        """Drop what ended long before a monotonic time [s]."""
        self._goals = {
            key: goal
            for key, goal in self._goals.items()
            if goal.ended_s is None or now_s - goal.ended_s < ENDED_KEPT_S
        }
        for key in list(self._goals)[: -2 * MAX_GOALS]:
            if self._goals[key].ended_s is not None:
                del self._goals[key]

    def messages(self) -> list[dict[str, Any]]:
        """The actionlib_msgs/GoalStatus of each, the oldest first."""
        return [goal.message() for goal in self._goals.values()]


def _stamp(goal_id: GoalId) -> Stamp:
    return Stamp(goal_id["stamp"]["sec"], goal_id["stamp"]["nanosec"])
