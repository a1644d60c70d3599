import gc
import weakref
from typing import Any

import pytest

from protocol.messages import BUDGET, ListLimits
from server.errors import GraphError
from server.graph.actions import (
    ENDED_KEPT_S,
    FEEDBACK,
    MAX_GOAL_S,
    MAX_PUBLISHED,
    STATUS,
    ActionGoal,
    GoalStatus,
    Result,
)
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.clock import FakeClock
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY

SERVER, SENDER = Node("server"), Node("sender", remote=True)
GRIPPER = "control_msgs/action/GripperCommand"
STATUS_TOPIC, FEEDBACK_TOPIC = f"/grip{STATUS}", f"/grip{FEEDBACK}"


class World:
    """An action in a time of its own that takes goals and does nothing with them, and one who sends and listens."""

    def __init__(self, provider: Node | None = None, made: str | None = None) -> None:
        self.clock = FakeClock()
        self.graph = Graph(REGISTRY, self.clock, lambda: 12.5, self.clock.call_later, relay_unknown_types=True)
        self.actions = self.graph.actions
        self.provider = provider or Node("provider", remote=True)
        self.goals: list[ActionGoal] = []
        self.results: list[Result] = []
        self.feedback: list[dict[str, Any]] = []
        self.heard: list[Any] = []
        if made is not None:
            self.graph.advertise(self.provider, made, "std_msgs/Time", latch=True)
        self.offer(self.provider)

    def offer(self, node: Node, name: str = "/grip", type_name: str = GRIPPER) -> None:
        self.actions.offer(node, name, type_name, self.goals.append)

    def send(self, sender: Node = SENDER, name: str = "/grip") -> ActionGoal:
        self.actions.send_goal(sender, name, GRIPPER, None, self.results.append, self.feedback.append)
        return self.goals[-1]

    def listen(self, topic: str = STATUS_TOPIC) -> None:
        subscriber = Subscriber(lambda published: self.heard.append(published.msg))
        self.heard += [earlier.msg for earlier in self.graph.subscribe(SENDER, topic, None, subscriber)]

    @property
    def statuses(self) -> list[int]:
        """Statuses in the last message."""
        return [each["status"] for each in self.heard[-1]["status_list"]]


@pytest.fixture
def world() -> World:
    return World()


def test_only_the_first_end_counts_and_nothing_is_heard_or_cancelled_afterwards(world: World) -> None:
    goal = world.send()
    goal.fail("jammed")
    goal.finish(GoalStatus.SUCCEEDED, {})
    goal.feedback({})
    goal.cancel()
    assert world.results == [Result(ok=False, status=6, values="jammed")]
    assert not goal.cancel_requested
    # A sender that has left hears nothing either.
    goal = world.send()
    goal.sender_left = True
    goal.feedback({})
    assert world.feedback == []


def test_the_cancel_service_cancels_one_goal_and_a_late_listener_is_told_at_once(world: World) -> None:
    goals = [world.send() for _ in range(2)]
    answer = answered(world.graph, "/grip/_action/cancel_goal", SENDER, goal_info=goals[1].info)
    assert [goal.cancel_requested for goal in goals] == [False, True]
    assert len(answer.values["goals_canceling"]) == 1
    told: list[str] = []
    goal = world.send()
    goal.cancel()
    goal.when_canceled(lambda: told.append("cancel"))
    assert told == ["cancel"]


def test_a_goal_to_a_misspelt_action_is_refused_with_the_server_s_action_that_was_meant(world: World) -> None:
    world.offer(SERVER, "/gripper_cmd")
    world.actions.send_goal(SENDER, "/griper_cmd", GRIPPER, None, world.results.append)
    (result,) = world.results
    assert (result.ok, result.values) == (False, "action /griper_cmd: does not exist; did you mean /gripper_cmd?")


def test_an_ended_goal_is_freed_without_the_garbage_collector(world: World) -> None:
    world.send()
    ended = weakref.ref(world.goals.pop())
    gc.disable()
    try:
        world.actions.withdraw(world.provider, "/grip")
        # This clock keeps also the timers that were cancelled.
        world.clock.timers.clear()
        assert ended() is None
    finally:
        gc.enable()


def test_a_goal_is_freed_at_its_end_while_its_status_is_still_published(world: World) -> None:
    world.listen()
    world.send().finish(GoalStatus.SUCCEEDED, {})
    ended = weakref.ref(world.goals.pop())
    world.clock.timers.clear()
    world.send()
    assert world.statuses == [GoalStatus.SUCCEEDED, GoalStatus.EXECUTING]
    assert ended() is None


def test_no_goal_lasts_for_ever_and_one_that_has_ended_leaves_nothing_behind(world: World) -> None:
    world.send()
    world.clock.advance(MAX_GOAL_S)
    assert not world.results[0].ok
    world.send().finish(GoalStatus.SUCCEEDED, {})
    assert world.clock.waiting == 0
    assert not world.actions._offers["/grip"].requests


def test_the_number_of_actions_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.graph.actions.MAX_ACTIONS", 5)
    world = World()
    for number in range(4):
        world.offer(SERVER, f"/a{number}")
    with pytest.raises(GraphError, match="there are 5 actions"):
        world.offer(SERVER, "/one_more")


def test_goals_go_on_without_their_sender_unless_it_takes_them_along(world: World) -> None:
    leaving = Node("leaving", remote=True, takes_goals_along=True)
    goals = [world.send(sender) for sender in (SENDER, leaving)]
    world.actions.remove(SENDER)
    world.actions.remove(leaving)
    assert [goal.cancel_requested for goal in goals] == [False, True]
    assert world.results == []


def test_a_bug_in_an_action_ends_the_goal_with_a_sentence(world: World, caplog: pytest.LogCaptureFixture) -> None:
    def start(_goal: ActionGoal) -> None:
        raise ValueError("broken")

    world.actions.offer(SERVER, "/lift", GRIPPER, start)
    world.actions.send_goal(SENDER, "/lift", GRIPPER, None, world.results.append)
    assert [(result.ok, result.status) for result in world.results] == [(False, GoalStatus.ABORTED)]
    assert "broken" in world.results[0].values
    assert "/lift" in caplog.text


# Topics


@pytest.mark.parametrize("topic", [STATUS_TOPIC, FEEDBACK_TOPIC])
def test_nothing_is_published_on_a_topic_of_this_name_that_the_provider_has_made_itself(topic: str) -> None:
    world = World(made=topic)
    world.listen(topic)
    world.send().feedback({})
    assert world.heard == []


@pytest.mark.parametrize("status", [GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED])
def test_the_status_of_a_goal_follows_it_to_its_end(world: World, status: GoalStatus) -> None:
    world.listen()
    goal = world.send()
    assert world.statuses == [2]
    goal.cancel()
    assert world.statuses == [3]
    goal.finish(status, {})
    assert world.statuses == [status]


def test_messages_are_complete(world: World) -> None:
    world.listen()
    world.listen(FEEDBACK_TOPIC)
    goal = world.send()
    # Feedback is heard though the sender has left.
    goal.sender_left = True
    goal.feedback({"position": 1.0})
    status, feedback = world.heard
    for name, message in (
        ("action_msgs/msg/GoalStatusArray", status),
        ("control_msgs/action/GripperCommand_FeedbackMessage", feedback),
    ):
        assert world.graph.message_types.complete(name, message) == message
    info = status["status_list"][0]["goal_info"]
    assert info == {"stamp": {"sec": 12, "nanosec": 500_000_000}, "goal_id": feedback["goal_id"]}
    assert feedback["feedback"]["position"] == 1.0


def test_the_newest_goals_that_were_taken_on_are_told_also_a_while_after_their_end(world: World) -> None:
    world.listen()
    world.send().fail("no", GoalStatus.UNKNOWN)
    assert world.statuses == []
    world.send().finish(GoalStatus.SUCCEEDED, {})
    world.clock.advance(ENDED_KEPT_S / 2)
    world.send()
    assert world.statuses == [4, 2]
    world.clock.advance(ENDED_KEPT_S / 2)
    world.send()
    assert world.statuses == [2, 2]
    for _ in range(3 * MAX_PUBLISHED):
        world.send().finish(GoalStatus.SUCCEEDED, {})
    last = world.send()
    assert len(world.statuses) == MAX_PUBLISHED
    assert len(world.actions._published["/grip"]) <= MAX_PUBLISHED + len(world.actions._offers["/grip"].requests)
    assert world.statuses[-1] == 2
    last.finish(GoalStatus.ABORTED, {})
    assert world.statuses[-1] == 6


def test_the_topics_go_with_their_action_and_pass_to_the_client_that_takes_it_over(world: World) -> None:
    goal = world.send()
    world.listen()
    # A late subscriber gets the last status.
    assert world.statuses == [2]
    world.actions.withdraw(world.provider, "/grip")
    assert goal.ended
    assert world.statuses == [6]
    assert world.graph.publishers(STATUS_TOPIC) == world.graph.publishers(FEEDBACK_TOPIC) == []
    former, later = Node("former", remote=True), Node("later", remote=True)
    world.offer(former)
    world.offer(later)
    assert world.graph.publishers(STATUS_TOPIC) == [later]
    world.send()
    assert world.statuses == [2]


def test_an_action_of_an_unknown_type_or_with_a_topic_of_somebody_else_works_without_that_topic(world: World) -> None:
    world.graph.advertise(SENDER, "/lift/_action/status", "std_msgs/String")
    world.offer(SERVER, "/lift")
    goal = world.send(name="/lift")
    goal.feedback({})
    goal.finish(GoalStatus.SUCCEEDED, {})
    assert goal.ended
    world.offer(SERVER, "/other", "acme_msgs/Do")
    assert world.graph.publishers("/other/_action/status") == [SERVER]
    assert world.graph.publishers("/other/_action/feedback") == []


def test_a_goal_with_too_long_a_list_is_refused_before_it_is_completed(world: World) -> None:
    type_name, limits = "moveit_msgs/action/MoveGroupSequence", {"moveit_msgs/msg/MotionSequenceRequest.items": 2}
    world.actions.offer(SERVER, "/move", type_name, world.goals.append, ListLimits(limits))
    request = {"request": {"items": [{}] * 3}}
    assert world.actions.send_goal(SENDER, "/move", type_name, request, world.results.append) is None
    assert "at most 2 elements in all, got 3" in world.results[0].values
    assert BUDGET.taken == 0
