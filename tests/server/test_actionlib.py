from typing import Any

import pytest

from protocol.dialect import to_ros1
from server.actionlib import MAX_GOALS, ActionlibStatus, bridge_actions, has_actionlib_types
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY

MOVE, MOVE_TYPE = "/move_group", "moveit_msgs/action/MoveGroup"
FOLLOW, FOLLOW_TYPE = "/follow", "control_msgs/action/FollowJointTrajectory"


class Stage:
    """Two actions that do what a test says, and a client that listens to all their topics."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.graph = Graph(REGISTRY, self.clock, lambda: 1000.0, self.clock.call_later)
        self.goals: list[ActionGoal] = []
        self.heard: dict[str, list[Any]] = {}
        server = Node("server")
        for name, type_name in ((MOVE, MOVE_TYPE), (FOLLOW, FOLLOW_TYPE)):
            self.graph.actions.offer(server, name, type_name, self.goals.append)
        bridge_actions(self.graph)
        self.client = Node("client", remote=True)
        for name in (MOVE, FOLLOW):
            for part in ("status", "feedback", "result"):
                messages = self.heard[f"{name}/{part}"] = []
                subscriber = Subscriber(lambda published, to=messages: to.append(published.msg))
                self.graph.subscribe(self.client, f"{name}/{part}", None, subscriber)

    def send(self, name: str = "one", topic: str = f"{MOVE}/goal", **goal: Any) -> None:
        self.graph.publish(self.client, topic, {"goal_id": {"id": name}, "goal": goal})

    def cancel(self, **goal_id: Any) -> None:
        self.graph.publish(self.client, f"{MOVE}/cancel", goal_id)

    def statuses(self) -> list[tuple[str, int]]:
        """Ids and statuses of the latest array."""
        return [(one["goal_id"]["id"], one["status"]) for one in self.heard[f"{MOVE}/status"][-1]["status_list"]]

    def results(self) -> list[tuple[str, int, str, int]]:
        """Id, status, text and error code of every result."""
        heard = self.heard[f"{MOVE}/result"]
        ended = [(one["status"], one["result"]["error_code"]["val"]) for one in heard]
        return [(status["goal_id"]["id"], status["status"], status["text"], code) for status, code in ended]


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_a_status_comes_five_times_a_second_before_there_is_any_goal(stage: Stage) -> None:
    stage.clock.advance(1.1)
    assert len(stage.heard[f"{MOVE}/status"]) == 5


def test_a_goal_goes_its_way_from_active_to_its_result_and_is_told_of_for_five_more_seconds(stage: Stage) -> None:
    stage.send(request={"group_name": "arm"})
    assert stage.goals[0].request["request"]["group_name"] == "arm"
    assert stage.statuses() == [("one", ActionlibStatus.ACTIVE)]
    stage.goals[0].feedback({"state": "MONITOR"})
    stage.goals[0].finish(GoalStatus.SUCCEEDED, {"error_code": {"val": 1, "message": "there"}})
    assert [one["feedback"]["state"] for one in stage.heard[f"{MOVE}/feedback"]] == ["MONITOR"]
    assert stage.results() == [("one", ActionlibStatus.SUCCEEDED, "there", 1)]
    for after_s, told in ((0.0, True), (4.0, True), (2.0, False)):
        stage.clock.advance(after_s)
        assert stage.statuses() == [("one", ActionlibStatus.SUCCEEDED)] * told


def test_of_many_goals_the_oldest_that_have_ended_are_not_kept(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.actionlib.MAX_GOALS", 20)
    stage.send("runs")
    for number in range(60):
        stage.send(f"{number}")
        stage.goals[-1].finish(GoalStatus.SUCCEEDED, {})
    assert stage.statuses()[0] == ("runs", ActionlibStatus.ACTIVE)
    assert [name for name, _ in stage.statuses()[1:]] == [f"{each}" for each in range(20, 60)]


def test_a_cancelled_goal_is_preempting_until_it_ends(stage: Stage) -> None:
    stage.send("one")
    stage.send("two")
    stage.cancel(id="two")
    assert [goal.cancel_requested for goal in stage.goals] == [False, True]
    stage.goals[1].feedback({"state": "MONITOR"})
    assert stage.statuses() == [("one", ActionlibStatus.ACTIVE), ("two", ActionlibStatus.PREEMPTING)]
    stage.goals[1].finish(GoalStatus.CANCELED, {"error_code": {"val": -7}})
    assert stage.results() == [("two", ActionlibStatus.PREEMPTED, "", -7)]
    stage.cancel(id="two")
    assert stage.statuses() == [("one", ActionlibStatus.ACTIVE), ("two", ActionlibStatus.PREEMPTED)]


def test_a_goal_that_fails_or_whose_action_is_withdrawn_is_answered_with_the_sentence(stage: Stage) -> None:
    stage.send()
    stage.goals[0].fail("broken")
    assert stage.results() == [("one", ActionlibStatus.ABORTED, "broken", 0)]
    server = stage.graph.actions.provider(MOVE)
    assert server is not None
    stage.graph.actions.withdraw(server, MOVE)
    stage.send("two")
    name, status, text, _ = stage.results()[1]
    assert (name, status, "does not exist" in text) == ("two", ActionlibStatus.REJECTED, True)


def test_more_goals_than_anyone_can_wait_for_are_rejected(stage: Stage) -> None:
    for number in range(MAX_GOALS + 1):
        stage.send(f"{number}")
    assert len(stage.goals) == MAX_GOALS
    assert {status for _, status, _, _ in stage.results()} == {ActionlibStatus.REJECTED}


def test_a_goal_that_is_sent_twice_runs_once(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.send()
    stage.send()
    assert len(stage.goals) == 1
    assert "'one'" in caplog.text


@pytest.mark.parametrize(
    ("cancel", "canceled"),
    [
        ({}, [True, True, True]),
        ({"stamp": {"sec": 11}}, [True, True, False]),
        ({"id": "c", "stamp": {"sec": 10}}, [True, False, True]),
    ],
    ids=["all", "no younger than a stamp", "a stamp and an id"],
)
def test_a_cancel_names_goals_by_id_and_stamp(stage: Stage, cancel: dict[str, Any], canceled: list[bool]) -> None:
    for sec, name in enumerate("abc", 10):
        stage.graph.publish(stage.client, f"{MOVE}/goal", {"goal_id": {"id": name, "stamp": {"sec": sec}}, "goal": {}})
    stage.cancel(**cancel)
    assert [goal.cancel_requested for goal in stage.goals] == canceled


def test_a_cancel_of_all_goals_ends_those_of_other_clients_that_ros_1_does_not_know(stage: Stage) -> None:
    stage.graph.actions.send_goal(Node("other", remote=True), MOVE, MOVE_TYPE, {}, lambda _result: None)
    stage.cancel(id="one")
    assert not stage.goals[0].cancel_requested
    stage.cancel()
    assert stage.goals[0].cancel_requested


def test_goals_without_an_id_get_one_each(stage: Stage) -> None:
    for _ in range(2):
        stage.send("")
    first, second = (name for name, _ in stage.statuses())
    assert first.startswith("/move_group-1-1000.")
    assert first != second


def test_ros_1_gets_the_fields_that_it_knows(stage: Stage) -> None:
    stage.send(topic=f"{FOLLOW}/goal", trajectory={"joint_names": ["a"]})
    stage.goals[0].feedback({"joint_names": ["a"], "index": 3})
    stage.goals[0].finish(GoalStatus.ABORTED, {"error_code": -2, "error_string": "no such joint"})
    feedback, result = stage.heard[f"{FOLLOW}/feedback"][0], stage.heard[f"{FOLLOW}/result"][0]
    assert "index" not in feedback["feedback"]
    spelled = to_ros1(REGISTRY, "control_msgs/FollowJointTrajectoryActionResult", result)
    assert spelled["status"]["goal_id"]["stamp"] == {"secs": 1000, "nsecs": 0}
    assert spelled["status"]["text"] == spelled["result"]["error_string"] == "no such joint"


def test_goals_belong_to_the_client_that_published_them(stage: Stage) -> None:
    stage.client.takes_goals_along = True
    stage.send()
    assert stage.goals[0].sender is stage.client
    stage.graph.remove(stage.client)
    assert stage.goals[0].cancel_requested


def test_actions_that_ros_1_never_had_have_no_topics() -> None:
    assert has_actionlib_types(REGISTRY, MOVE_TYPE)
    assert not has_actionlib_types(REGISTRY, "control_msgs/action/ParallelGripperCommand")


def test_a_goal_of_a_client_that_may_not_send_one_is_rejected_to_it_alone(stage: Stage) -> None:
    other, heard = Node("other", remote=True), []
    for part in ("status", "result"):
        stage.graph.subscribe(other, f"{MOVE}/{part}", None, Subscriber(lambda published: heard.append(published.msg)))
    stage.send("driven")
    heard.clear()
    stage.heard[f"{MOVE}/status"].clear()
    stage.graph.reject_unauthorized(other, f"{MOVE}/goal", {"goal_id": {"id": "mine"}}, "another drives")
    status, result = heard
    assert [(each["goal_id"]["id"], each["status"]) for each in status["status_list"]] == [
        ("driven", ActionlibStatus.ACTIVE),
        ("mine", ActionlibStatus.REJECTED),
    ]
    assert (result["status"]["goal_id"]["id"], result["status"]["text"]) == ("mine", "another drives")
    assert len(stage.goals) == 1
    assert stage.heard[f"{MOVE}/status"] == stage.heard[f"{MOVE}/result"] == []


def test_a_rejected_goal_takes_no_id_from_others_and_an_unreadable_one_is_told_to_nobody(stage: Stage) -> None:
    stage.graph.reject_unauthorized(stage.client, f"{MOVE}/goal", {"goal_id": 5}, "another drives")
    assert stage.heard[f"{MOVE}/result"] == []
    stage.graph.reject_unauthorized(stage.client, f"{MOVE}/goal", {"goal_id": {"id": "one"}}, "another drives")
    stage.send("one")
    assert len(stage.goals) == 1
