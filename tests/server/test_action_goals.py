from __future__ import annotations

from typing import Any

import pytest

from protocol.errors import MessageError
from protocol.registry import Registry
from server.action_goals import Goal, GoalStatus, Result
from server.interfaces import Interfaces
from server.node import Node

INTERFACES = Interfaces(Registry.load())
DEFAULT = {"position": 0.0, "effort": 0.0, "stalled": False, "reached_goal": False}


class Sent:
    """A goal, and what its sender hears."""

    def __init__(self) -> None:
        self.feedback: list[dict[str, Any]] = []
        self.results: list[Result] = []
        self.goal = Goal(
            "/grip", "control_msgs/action/GripperCommand", {}, INTERFACES, self.feedback.append, Node("a client")
        )
        self.goal.when_ended(self.results.append)


@pytest.fixture
def sent() -> Sent:
    return Sent()


def test_feedback_and_result_are_completed(sent: Sent) -> None:
    sent.goal.feedback({"position": 1})
    sent.goal.finish(GoalStatus.SUCCEEDED, {"reached_goal": True})
    assert sent.feedback == [{**DEFAULT, "position": 1.0}]
    assert sent.results == [Result(ok=True, status=4, values={**DEFAULT, "reached_goal": True})]


def test_feedback_that_does_not_fit_is_an_error_to_the_provider_alone(sent: Sent) -> None:
    with pytest.raises(MessageError, match="position"):
        sent.goal.feedback({"position": "far"})
    assert sent.feedback == []
    assert not sent.goal.ended


def test_a_result_that_does_not_fit_ends_the_goal_as_a_failure(sent: Sent) -> None:
    with pytest.raises(MessageError, match="position"):
        sent.goal.finish(GoalStatus.SUCCEEDED, {"position": "far"})
    assert (sent.results[0].ok, sent.results[0].status) == (False, GoalStatus.ABORTED)


def test_only_the_first_end_counts_and_nothing_is_heard_afterwards(sent: Sent) -> None:
    sent.goal.fail("jammed")
    sent.goal.finish(GoalStatus.SUCCEEDED, {})
    sent.goal.feedback({})
    assert sent.results == [Result(ok=False, status=6, values="jammed")]
    assert sent.feedback == []


def test_a_cancel_is_told_once_and_the_provider_says_how_it_ends(sent: Sent) -> None:
    told: list[str] = []
    sent.goal.when_canceled(lambda: told.append("cancel"))
    sent.goal.cancel()
    sent.goal.cancel()
    assert told == ["cancel"]
    assert not sent.goal.ended
    sent.goal.finish(GoalStatus.CANCELED, {})
    assert sent.results[0].status == 5


def test_who_asks_late_is_told_of_a_cancel_at_once(sent: Sent) -> None:
    told: list[str] = []
    sent.goal.cancel()
    sent.goal.when_canceled(lambda: told.append("cancel"))
    assert told == ["cancel"]


def test_a_goal_that_has_ended_cannot_be_cancelled(sent: Sent) -> None:
    sent.goal.finish(GoalStatus.SUCCEEDED, {})
    sent.goal.cancel()
    assert not sent.goal.cancel_requested


def test_a_sender_that_left_hears_no_feedback(sent: Sent) -> None:
    sent.goal.forget_sender()
    sent.goal.feedback({})
    assert sent.feedback == []


def test_every_goal_has_an_id_of_its_own() -> None:
    assert len({Sent().goal.goal_id for _ in range(100)}) == 100
