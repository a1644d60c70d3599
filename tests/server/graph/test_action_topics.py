from typing import Any

import pytest

from server.graph.action_topics import ENDED_KEPT_S, MAX_PUBLISHED
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY

GRIPPER, STATUS, FEEDBACK = "control_msgs/GripperCommand", "/grip/_action/status", "/grip/_action/feedback"
CLIENT = Node("client", remote=True)


class World:
    """A graph with an action that takes goals and does nothing with them."""

    def __init__(self, provider: Node | None = None, made: str | None = None) -> None:
        self.clock = FakeClock()
        self.graph = Graph(REGISTRY, self.clock, lambda: 12.5, self.clock.call_later, relay_unknown_types=True)
        self.provider = provider or Node("provider")
        self.goals: list[ActionGoal] = []
        self.heard: list[Any] = []
        if made is not None:
            self.graph.advertise(self.provider, made, "std_msgs/Time", latch=True)
        self.graph.actions.offer(self.provider, "/grip", GRIPPER, self.goals.append)

    def listen(self, topic: str) -> None:
        subscriber = Subscriber(lambda published: self.heard.append(published.msg))
        self.heard += [earlier.msg for earlier in self.graph.subscribe(CLIENT, topic, None, subscriber)]

    def send(self) -> ActionGoal:
        self.graph.actions.send_goal(CLIENT, "/grip", GRIPPER, {}, lambda _result: None)
        return self.goals[-1]

    @property
    def statuses(self) -> list[int]:
        """Statuses in the last message."""
        return [each["status"] for each in self.heard[-1]["status_list"]]


@pytest.fixture
def world() -> World:
    return World()


@pytest.mark.parametrize("topic", [STATUS, FEEDBACK])
def test_nothing_is_published_on_a_topic_of_this_name_that_the_provider_has_made_itself(topic: str) -> None:
    world = World(CLIENT, made=topic)
    world.listen(topic)
    world.send().feedback({})
    assert world.heard == []


@pytest.mark.parametrize(
    ("status", "told"), [(GoalStatus.SUCCEEDED, 4), (GoalStatus.CANCELED, 5), (GoalStatus.ABORTED, 6)]
)
def test_the_status_of_a_goal_follows_it_to_its_end(world: World, status: GoalStatus, told: int) -> None:
    world.listen(STATUS)
    goal = world.send()
    assert world.statuses == [2]
    goal.cancel()
    assert world.statuses == [3]
    goal.finish(status, {})
    assert world.statuses == [told]


def test_messages_are_complete(world: World) -> None:
    world.listen(STATUS)
    world.listen(FEEDBACK)
    goal = world.send()
    # Feedback is heard though the sender has left.
    goal.forget_sender()
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


def test_an_ended_goal_is_told_for_a_while_and_one_that_was_never_taken_on_is_not(world: World) -> None:
    world.listen(STATUS)
    world.send().fail("no", GoalStatus.UNKNOWN)
    assert world.statuses == []
    world.send().finish(GoalStatus.SUCCEEDED, {})
    world.clock.advance(ENDED_KEPT_S / 2)
    world.send()
    assert world.statuses == [4, 2]
    world.clock.advance(ENDED_KEPT_S / 2)
    world.send()
    assert world.statuses == [2, 2]


def test_of_many_goals_the_newest_are_told(world: World) -> None:
    world.listen(STATUS)
    for _ in range(3 * MAX_PUBLISHED):
        world.send().finish(GoalStatus.SUCCEEDED, {})
    last = world.send()
    assert len(world.statuses) == MAX_PUBLISHED
    assert world.statuses[-1] == 2
    last.finish(GoalStatus.ABORTED, {})
    assert world.statuses[-1] == 6


def test_the_topics_go_with_their_action(world: World) -> None:
    goal = world.send()
    world.listen(STATUS)
    # A late subscriber gets the last status.
    assert world.statuses == [2]
    world.graph.actions.withdraw(world.provider, "/grip")
    assert goal.ended
    assert world.statuses == [6]
    assert world.graph.publishers(STATUS) == world.graph.publishers(FEEDBACK) == []


def test_the_topics_pass_to_the_client_that_takes_an_action_over() -> None:
    former, later = Node("former", remote=True), Node("later", remote=True)
    world = World(former)
    world.graph.actions.offer(later, "/grip", GRIPPER, world.goals.append)
    assert world.graph.publishers(STATUS) == [later]
    world.listen(STATUS)
    world.send()
    assert world.statuses == [2]


def test_an_action_of_an_unknown_type_or_with_a_topic_of_somebody_else_works_without_that_topic() -> None:
    world = World(Node("client", remote=True))
    world.graph.advertise(CLIENT, "/lift/_action/status", "std_msgs/String")
    world.graph.actions.offer(world.provider, "/lift", GRIPPER, world.goals.append)
    world.graph.actions.send_goal(CLIENT, "/lift", GRIPPER, {}, lambda _result: None)
    world.goals[0].feedback({})
    world.goals[0].finish(GoalStatus.SUCCEEDED, {})
    assert world.goals[0].ended
    world.graph.actions.offer(world.provider, "/other", "acme_msgs/Do", world.goals.append)
    assert world.graph.publishers("/other/_action/status") == [world.provider]
    assert world.graph.publishers("/other/_action/feedback") == []
