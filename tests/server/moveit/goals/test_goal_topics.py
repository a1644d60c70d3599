import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest

from harness.clients import values_of
from planners.problem import MoveItErrorCode
from protocol.errors import MessageError
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion, PlannedSequence
from server.execution.queue import GoalListener, GoalQueue
from server.graph.local_graph import LocalGraph
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.goals.goal_topics import (
    APPROVAL_TOPIC,
    APPROVE_TOPIC,
    CONFIRM_MODE_SERVICE,
    CONFIRM_TOPIC,
    RESULT_TOPIC,
    STATUS_TOPIC,
    Confirmation,
    GoalStatusTopics,
    GoalTopics,
)
from tests.helpers.fake_arm import settle
from tests.helpers.goal_runner import GoalRunner
from tests.helpers.graph import answered, listen
from tests.helpers.moveit import REGISTRY, translator
from tests.helpers.robots import so101

CLIENT = Node("client")


class Obedient(GoalRunner):
    """Reaches every goal at once, unless it is told to wait."""

    def __init__(self) -> None:
        super().__init__()
        self.go_on = asyncio.Event()
        self.go_on.set()
        self.cancelled: list[str] = []
        self.answer = Answer(MoveItErrorCode.SUCCESS, "there")

    async def run(self, goal: Goal) -> Answer:
        self.asked.append(goal.request.motion)
        goal.cancelled.add_done_callback(lambda reason: self.cancel(reason.result()))
        goal.report(Progress(GoalState.EXECUTING, "moving", 0.25, 1.5))
        await self.go_on.wait()
        return self.answer

    def cancel(self, reason: str) -> None:
        self.cancelled.append(reason)
        self.go_on.set()


class Desk(GoalListener):
    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.runner = Obedient()
        self.confirmation = Confirmation(self.graph, enabled=False, timeout_s=60.0)
        node = Node("moveit")
        self.status = GoalStatusTopics(LocalGraph(self.graph), node, so101())
        self.queue = GoalQueue(self.runner, GoalPolicy.QUEUE, 4)
        self.queue.listeners.append(self)
        self.queue.start()
        GoalTopics(LocalGraph(self.graph), node, self.queue, translator(), self.confirmation)
        self.heard = {topic: listen(self.graph, topic) for topic in (RESULT_TOPIC, STATUS_TOPIC)}

    def on_progress(self, goal: Goal, progress: Progress) -> None:
        self.status.publish_progress(goal, progress)

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        self.status.publish_answer(goal, answer)

    async def publish(self, topic: str, message: dict[str, Any]) -> None:
        self.graph.publish(CLIENT, topic, message)
        for _ in range(10):
            await asyncio.sleep(0)


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.queue.close(0.1)


def states(desk: Desk) -> list[str]:
    return [status["values"][0]["value"] for status in desk.heard[STATUS_TOPIC]]


async def test_status_and_result_name_the_goals_topic_and_id(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    assert desk.heard[RESULT_TOPIC] == [{"val": 1, "message": "there", "source": "/moveit_goal_named#1"}]
    assert states(desk) == ["queued", "executing", "done"]
    moving = desk.heard[STATUS_TOPIC][1]
    assert (moving["name"], moving["hardware_id"], moving["level"]) == ("/moveit_goal_named", "1", 0)
    assert {pair["key"]: pair["value"] for pair in moving["values"]} == {
        "state": "executing",
        "fraction": "0.250",
        "seconds_left": "1.50",
    }


async def test_an_invalid_message_is_a_rejected_goal(desk: Desk) -> None:
    with pytest.raises(MessageError):
        await desk.publish("/moveit_goal_joints", {"name": 5})
    assert [result["val"] for result in desk.heard[RESULT_TOPIC]] == [-16]
    assert "name" in desk.heard[RESULT_TOPIC][0]["message"]
    assert desk.heard[STATUS_TOPIC][-1]["level"] == 2


async def test_ignored_joints_are_logged(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.publish("/moveit_goal_joints", {"name": ["knee", "elbow_flex"], "position": [1.0, 0.2]})
    assert "ignored joints that are not in group arm: knee" in caplog.text


@pytest.mark.parametrize(
    ("topic", "message"), [("/stop", {}), ("/trajectory_execution_event", {"data": "stop"})], ids=["/stop", "event"]
)
async def test_a_stop_reaches_the_arm_with_its_source(desk: Desk, topic: str, message: dict[str, Any]) -> None:
    desk.runner.go_on.clear()
    await desk.publish("/moveit_goal_named", {"data": "ready"})
    await desk.publish(topic, message)
    assert desk.runner.stopped == [None]
    assert desk.runner.cancelled == [f"stopped by {topic}"]


async def test_one_goal_is_cancelled_by_its_id(desk: Desk) -> None:
    desk.runner.go_on.clear()
    for name in ("ready", "home", "rest"):
        await desk.publish("/moveit_goal_named", {"data": name})
    await desk.publish("/moveit_goal_cancel", {"data": "2"})
    assert [(result["val"], result["source"]) for result in desk.heard[RESULT_TOPIC]] == [(-7, "/moveit_goal_named#2")]
    assert "/moveit_goal_cancel" in desk.heard[RESULT_TOPIC][0]["message"]
    await desk.publish("/moveit_goal_cancel", {"data": "99"})
    assert desk.runner.stopped == []
    await desk.publish("/moveit_goal_cancel", {"data": "1"})
    assert desk.runner.cancelled == ["cancelled by /moveit_goal_cancel"]


async def test_another_event_stops_nothing(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.publish("/trajectory_execution_event", {"data": "dance"})
    assert desk.runner.stopped == []
    assert "'dance'" in caplog.text


async def test_every_status_has_the_stamp_of_the_goal(desk: Desk) -> None:
    stamp = {"sec": 17, "nanosec": 4_000_001}
    await desk.publish("/moveit_goal_joints", {"header": {"stamp": stamp}, "name": ["elbow_flex"], "position": [0.2]})
    assert [values_of(status)["stamp"] for status in desk.heard[STATUS_TOPIC]] == ["17.004000001"] * 3


async def test_a_suggested_goal_is_in_the_final_status_and_named_in_the_result(desk: Desk) -> None:
    await desk.publish("/moveit_goal_named", {"data": "redy"})
    values = values_of(desk.heard[STATUS_TOPIC][-1])
    suggested = json.loads(values["suggested_goal"])
    assert suggested == {"topic": "/moveit_goal_named", "type": "std_msgs/String", "msg": {"data": "ready"}}
    assert "'ready'" in desk.heard[RESULT_TOPIC][-1]["message"]
    await desk.publish(suggested["topic"], suggested["msg"])
    assert desk.heard[RESULT_TOPIC][-1]["val"] == 1


@pytest.mark.parametrize("wanted", [True, False])
async def test_goals_wait_for_confirmation_while_that_is_wanted(desk: Desk, *, wanted: bool) -> None:
    desk.confirmation.enabled = wanted
    await desk.publish("/moveit_goal_named", {"data": "home"})
    (ran,) = desk.runner.asked
    assert isinstance(ran, PlannedMotion)
    assert ran.confirm is wanted


async def test_the_refusal_of_a_goal_goes_to_its_sender_alone(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    sender, answers = Node("sender", remote=True), []
    for topic in (RESULT_TOPIC, STATUS_TOPIC):
        desk.graph.subscribe(sender, topic, None, Subscriber(lambda published: answers.append(published.msg)))
    desk.graph.reject_unauthorized(sender, "/moveit_goal_named", {"data": "home"}, "another drives")
    status, result = answers
    assert result == {"val": -4, "message": "another drives", "source": "/moveit_goal_named#1"}
    assert (values_of(status)["state"], status["level"], status["hardware_id"]) == ("done", 2, "1")
    assert desk.heard == {RESULT_TOPIC: [], STATUS_TOPIC: []}
    assert desk.runner.asked == []
    assert not caplog.records


class Gate:
    def __init__(self, timeout_s: float = 60.0) -> None:
        self.graph = Graph(REGISTRY)
        self.confirmation = Confirmation(self.graph, enabled=False, timeout_s=timeout_s)

    def say(self, msg: dict[str, Any]) -> None:
        self.graph.publish(CLIENT, CONFIRM_TOPIC, msg)


@pytest.fixture
async def gate() -> Gate:
    return Gate()


PLANNED = PlannedSequence(Performed({}), ("RRTConnect",))


def goal(number: str = "7", *, proposed: bool = False) -> Goal:
    motion = PlannedMotion((), frozenset(), confirm=True, proposed=proposed)
    return Goal(number, GoalRequest("/moveit_goal", motion, client="agent (10.0.0.5:5)"))


async def asked(gate: Gate, *, proposed: bool = False) -> asyncio.Task[Any]:
    task = asyncio.create_task(gate.confirmation.wait(goal(proposed=proposed), PLANNED))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return task


async def test_a_client_that_hears_that_a_plan_waits_can_decide_at_once(gate: Gate) -> None:
    def decide(progress: Progress) -> None:
        assert progress.state is GoalState.PLANNED
        gate.say({"data": True})

    assert await gate.confirmation.wait(Goal("7", goal().request, decide), PLANNED) is None


async def test_a_plan_that_is_not_confirmed_in_time_is_discarded() -> None:
    for proposed, topic in ((False, CONFIRM_TOPIC), (True, APPROVE_TOPIC)):
        answer = await Gate(timeout_s=0.01).confirmation.wait(goal(proposed=proposed), PLANNED)
        assert answer is not None
        assert answer.code is MoveItErrorCode.TIMED_OUT
        assert answer.message.endswith(f"not confirmed on {topic} within 0.01 s")


async def test_a_decision_counts_only_for_the_plan_that_waits(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    gate.say({"data": True})
    assert "no goal waits" in caplog.text
    task = await asked(gate)
    assert not task.done()
    gate.say({"data": True})
    gate.say({"data": False})
    assert await task is None


async def test_a_proposal_is_approved_by_its_id_alone(gate: Gate, caplog: pytest.LogCaptureFixture) -> None:
    def approve(goal_id: str) -> None:
        gate.graph.publish(CLIENT, APPROVE_TOPIC, {"data": goal_id})

    approve("7")
    assert f"{APPROVE_TOPIC}: ignored, no goal waits" in caplog.text
    task = await asked(gate, proposed=True)
    # A click that was meant for the goal before, and a client that names none.
    approve("6")
    gate.say({"data": True})
    await settle()
    assert not task.done()
    assert "goal 7 waits, not '6'" in caplog.text
    assert f"goal 7 is approved on {APPROVE_TOPIC}" in caplog.text
    approve("7")
    approve("7")
    assert await task is None
    gate.say({"data": False})
    task = await asked(gate, proposed=True)
    gate.say({"data": False})
    assert (await task).code is MoveItErrorCode.PREEMPTED


async def test_the_goal_that_waits_is_latched(gate: Gate) -> None:
    def request() -> dict[str, Any]:
        status = listen(gate.graph, APPROVAL_TOPIC)[-1]
        return {**status, **{each["key"]: each["value"] for each in status["values"]}}

    assert (request()["hardware_id"], request()["message"]) == ("", "no goal waits")
    task = await asked(gate, proposed=True)
    waiting = request()
    assert (waiting["hardware_id"], waiting["client"], waiting["proposed"]) == ("7", "agent (10.0.0.5:5)", "true")
    assert waiting["message"].startswith("goal 7 of agent (10.0.0.5:5) from /moveit_goal waits: ")
    task.cancel()
    await asyncio.wait([task])
    assert request()["hardware_id"] == ""


async def test_the_service_switches_the_mode(gate: Gate) -> None:
    assert answered(gate.graph, CONFIRM_MODE_SERVICE, data=True).values["success"]
    assert gate.confirmation.enabled


GROUP_TOPIC = "/moveit_goal_group"


def group_told(desk: Desk) -> str:
    """The group that a client sees which comes now."""
    return str(listen(desk.graph, GROUP_TOPIC)[-1]["data"])


async def test_the_group_of_goals_is_latched_and_can_be_chosen(desk: Desk) -> None:
    assert group_told(desk) == "arm"
    await desk.publish(GROUP_TOPIC, {"data": "gripper"})
    assert group_told(desk) == "gripper"
    await desk.publish(GROUP_TOPIC, {"data": ""})
    assert group_told(desk) == "arm"


async def test_an_unknown_group_is_told_with_those_that_exist_and_changes_nothing(desk: Desk) -> None:
    await desk.publish(GROUP_TOPIC, {"data": "legs"})
    status = desk.heard[STATUS_TOPIC][-1]
    assert (status["level"], status["name"]) == (2, GROUP_TOPIC)
    assert "there is no planning group 'legs'; there are: arm" in status["message"]
    assert desk.heard[RESULT_TOPIC] == []
    assert group_told(desk) == "arm"


async def test_goals_of_several_groups_are_confirmed_one_after_the_other() -> None:
    confirmation = Confirmation(Graph(REGISTRY), enabled=True, timeout_s=60.0)
    first, second = (asyncio.create_task(confirmation.wait(goal(number), PLANNED)) for number in "12")
    for waiting in (first, second):
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        confirmation._decide("/moveit_goal_confirm", go=True)
        assert await asyncio.wait_for(waiting, 1.0) is None
