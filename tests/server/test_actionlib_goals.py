from __future__ import annotations

from protocol.messages import Stamp
from server.actionlib_goals import ENDED_KEPT_S, MAX_GOALS, Status, TrackedGoals

NOW = Stamp(100, 5)


def goal_id(name: str = "", sec: int = 0) -> dict[str, object]:
    return {"id": name, "stamp": {"sec": sec, "nanosec": 0}}


def tracked(*names: str) -> TrackedGoals:
    goals = TrackedGoals("/move")
    for index, name in enumerate(names):
        goals.add(goal_id(name, 10 + index), NOW)
    return goals


def test_a_goal_without_id_and_stamp_gets_both() -> None:
    goals = TrackedGoals("/move")
    first, second = goals.add(goal_id(), NOW), goals.add(goal_id(), NOW)
    assert first is not None
    assert second is not None
    assert first.goal_id["stamp"] == {"sec": 100, "nanosec": 5}
    assert first.key.startswith("/move-1-100.")
    assert first.key != second.key


def test_an_id_that_is_known_is_not_taken_on_again() -> None:
    assert tracked("a").add(goal_id("a"), NOW) is None


def test_a_cancel_that_says_nothing_means_all_goals_on_their_way() -> None:
    goals = tracked("a", "b", "c")
    goals.end("b", Status.SUCCEEDED, "", 0.0)
    assert goals.to_cancel(goal_id()) == ["a", "c"]


def test_a_cancel_means_the_goal_of_its_id() -> None:
    assert tracked("a", "b").to_cancel(goal_id("b")) == ["b"]


def test_a_cancel_with_a_stamp_means_all_that_are_no_younger_and_the_one_of_its_id() -> None:
    goals = tracked("a", "b", "c", "d")
    assert goals.to_cancel(goal_id("d", 11)) == ["a", "b", "d"]


def test_the_end_of_a_goal_is_told_once_and_for_five_seconds() -> None:
    goals = tracked("a", "b")
    assert goals.end("a", Status.ABORTED, "why", 50.0) is not None
    assert goals.end("a", Status.SUCCEEDED, "", 50.0) is None
    goals.forget(50.0 + ENDED_KEPT_S - 0.1)
    assert [(one["goal_id"]["id"], one["status"], one["text"]) for one in goals.messages()] == [
        ("a", Status.ABORTED, "why"),
        ("b", Status.PENDING, ""),
    ]
    goals.forget(50.0 + ENDED_KEPT_S)
    assert [one["goal_id"]["id"] for one in goals.messages()] == ["b"]


def test_goals_are_bounded_on_their_way_and_after_their_end() -> None:
    goals = TrackedGoals("/move")
    for number in range(3 * MAX_GOALS):
        assert not goals.full
        goals.add(goal_id(f"{number}"), NOW)
        goals.end(f"{number}", Status.SUCCEEDED, "", 50.0)
    goals.forget(50.0)
    assert len(goals.messages()) == 2 * MAX_GOALS
    for number in range(MAX_GOALS):
        goals.add(goal_id(f"more {number}"), NOW)
    assert goals.full
