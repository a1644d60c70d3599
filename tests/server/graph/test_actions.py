import gc
import weakref
from base64 import b64encode
from typing import Any

import pytest

from server.errors import GraphError
from server.graph.actions import MAX_GOAL_S, ActionGoal, GoalStatus, Result
from server.graph.node import Node
from server.graph.topics import Graph
from tests.helpers.clock import FakeClock
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY

SERVER, SENDER = Node("server"), Node("sender", remote=True)
GRIPPER = "control_msgs/action/GripperCommand"


class World:
    """Actions and services in a time of their own."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.graph = Graph(REGISTRY, self.clock, call_later=self.clock.call_later)
        self.actions = self.graph.actions
        self.results: list[Result] = []
        self.feedback: list[dict[str, Any]] = []

    def offer(self, node: Node | None = None, name: str = "/grip") -> tuple[Node, list[ActionGoal]]:
        """A client, or another node, that takes goals and does nothing with them."""
        node = node or Node("provider", remote=True)
        goals: list[ActionGoal] = []
        self.actions.offer(node, name, GRIPPER, goals.append)
        return node, goals

    def send(self) -> None:
        self.actions.send_goal(SENDER, "/grip", GRIPPER, None, self.results.append, self.feedback.append)


@pytest.fixture
def world() -> World:
    return World()


def test_only_the_first_end_counts_and_nothing_is_heard_or_cancelled_afterwards(world: World) -> None:
    _, goals = world.offer()
    world.send()
    goals[0].fail("jammed")
    goals[0].finish(GoalStatus.SUCCEEDED, {})
    goals[0].feedback({})
    goals[0].cancel()
    assert world.results == [Result(ok=False, status=6, values="jammed")]
    assert not goals[0].cancel_requested
    # A sender that has left hears nothing either.
    world.send()
    goals[1].forget_sender()
    goals[1].feedback({})
    assert world.feedback == []


def test_the_cancel_service_cancels_one_goal_by_its_id(world: World) -> None:
    _, goals = world.offer()
    for _ in range(2):
        world.send()
    goal_id = {"uuid": b64encode(goals[1].goal_id).decode()}
    answer = answered(world.graph, "/grip/_action/cancel_goal", SENDER, goal_info={"goal_id": goal_id})
    assert [goal.cancel_requested for goal in goals] == [False, True]
    assert len(answer.values["goals_canceling"]) == 1


def test_a_late_listener_is_told_of_a_cancel_at_once(world: World) -> None:
    _, goals = world.offer()
    world.send()
    told: list[str] = []
    goals[0].cancel()
    goals[0].when_canceled(lambda: told.append("cancel"))
    assert told == ["cancel"]


def test_an_ended_goal_is_freed_without_the_garbage_collector(world: World) -> None:
    provider, goals = world.offer()
    world.send()
    ended = weakref.ref(goals.pop())
    gc.disable()
    try:
        world.actions.withdraw(provider, "/grip")
        # This clock keeps also the timers that were cancelled.
        world.clock.timers.clear()
        assert ended() is None
    finally:
        gc.enable()


def test_no_goal_lasts_for_ever(world: World) -> None:
    world.offer()
    world.send()
    world.clock.advance(MAX_GOAL_S)
    assert not world.results[0].ok


def test_a_goal_that_has_ended_leaves_nothing_behind(world: World) -> None:
    _, goals = world.offer()
    world.send()
    goals[0].finish(GoalStatus.SUCCEEDED, {})
    assert world.clock.waiting == 0
    assert not world.actions._offers["/grip"].requests


def test_the_number_of_actions_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.graph.actions.MAX_ACTIONS", 5)
    world = World()
    for number in range(5):
        world.offer(SERVER, f"/a{number}")
    with pytest.raises(GraphError, match="there are 5 actions"):
        world.offer(SERVER, "/one_more")


def test_goals_go_on_without_their_sender_unless_it_takes_them_along(world: World) -> None:
    _, goals = world.offer()
    world.send()
    leaving = Node("leaving", remote=True, takes_goals_along=True)
    world.actions.send_goal(leaving, "/grip", GRIPPER, None, world.results.append)
    world.actions.remove(SENDER)
    world.actions.remove(leaving)
    assert [goal.cancel_requested for goal in goals] == [False, True]
    assert world.results == []


def test_a_bug_in_an_action_ends_the_goal_with_a_sentence(world: World, caplog: pytest.LogCaptureFixture) -> None:
    def start(_goal: ActionGoal) -> None:
        raise ValueError("broken")

    world.actions.offer(SERVER, "/grip", GRIPPER, start)
    world.send()
    assert [(result.ok, result.status) for result in world.results] == [(False, GoalStatus.ABORTED)]
    assert "broken" in world.results[0].values
    assert "/grip" in caplog.text
