from base64 import b64encode
from typing import Any

import pytest

from server.errors import GraphError
from server.graph.actions import MAX_GOAL_S, ActionGoal, GoalStatus, Result
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY

INTERFACES = MessageTypes(REGISTRY)


class Sent:
    """A goal, and what its sender hears."""

    def __init__(self) -> None:
        self.feedback: list[dict[str, Any]] = []
        self.results: list[Result] = []
        names = "/grip", "control_msgs/action/GripperCommand"
        self.goal = ActionGoal(names, {}, INTERFACES, Node("a client"), self.feedback.append)
        self.goal.when_ended(self.results.append)


@pytest.fixture
def sent() -> Sent:
    return Sent()


def test_only_the_first_end_counts_and_nothing_is_heard_afterwards(sent: Sent) -> None:
    sent.goal.fail("jammed")
    sent.goal.finish(GoalStatus.SUCCEEDED, {})
    sent.goal.feedback({})
    assert sent.results == [Result(ok=False, status=6, values="jammed")]
    assert sent.feedback == []


def test_a_late_listener_is_told_of_a_cancel_at_once(sent: Sent) -> None:
    told: list[str] = []
    sent.goal.cancel()
    sent.goal.when_canceled(lambda: told.append("cancel"))
    assert told == ["cancel"]


def test_a_goal_that_ended_is_not_cancelled_and_a_sender_that_left_hears_nothing(sent: Sent) -> None:
    sent.goal.finish(GoalStatus.SUCCEEDED, {})
    sent.goal.cancel()
    assert not sent.goal.cancel_requested
    sent.goal.forget_sender()
    sent.goal.feedback({})
    assert sent.feedback == []


SERVER, SENDER = Node("server"), Node("sender", remote=True)
GRIPPER = "control_msgs/GripperCommand"


class World:
    """Actions and services in a time of their own."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        graph = Graph(REGISTRY, self.clock, call_later=self.clock.call_later)
        self.services, self.actions = graph.services, graph.actions
        self.results: list[Result] = []
        self.feedback: list[dict[str, Any]] = []

    def offer(self, node: Node | None = None, name: str = "/grip") -> tuple[Node, list[ActionGoal]]:
        """A client, or another node, that takes goals and does nothing with them."""
        node = node or Node("provider", remote=True)
        goals: list[ActionGoal] = []
        self.actions.offer(node, name, GRIPPER, goals.append)
        return node, goals

    def send(self, name: str = "/grip", type_name: str = GRIPPER, arguments: object = None) -> ActionGoal | None:
        return self.actions.send_goal(SENDER, name, type_name, arguments, self.results.append, self.feedback.append)

    def cancel_service(self, request: dict[str, Any]) -> Any:
        responses: list[Response] = []
        self.services.call(SENDER, "/grip/_action/cancel_goal", request, responses.append)
        return responses[0].values


@pytest.fixture
def world() -> World:
    return World()


def test_a_local_part_may_end_a_goal_later_and_as_canceled(world: World) -> None:
    _, goals = world.offer(SERVER)
    goal = world.send()
    assert goal is not None
    goals[0].when_canceled(lambda: goals[0].finish(GoalStatus.CANCELED, {}))
    assert world.results == []
    goal.cancel()
    assert world.results[0].status == 5


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


def test_the_cancel_service_cancels_one_goal_by_its_id(world: World) -> None:
    _, goals = world.offer()
    for _ in range(2):
        world.send()
    answer = world.cancel_service({"goal_info": {"goal_id": {"uuid": b64encode(goals[1].goal_id).decode()}}})
    assert [goal.cancel_requested for goal in goals] == [False, True]
    assert len(answer["goals_canceling"]) == 1


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
    staying, leaving = SENDER, Node("leaving", remote=True, takes_goals_along=True)
    world.actions.send_goal(leaving, "/grip", GRIPPER, None, world.results.append)
    world.actions.remove(staying)
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
