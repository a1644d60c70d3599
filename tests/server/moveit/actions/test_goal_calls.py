"""The service and the action ``/moveit_goal``: on the queue, and through the executor on a graph."""

from collections.abc import AsyncIterator
from typing import Any

import pytest

from harness.waiting import until
from planners.problem import MoveItErrorCode, PlanningProblem
from server.execution.goal import Answer, GoalPolicy
from server.graph.actions import GoalStatus
from server.graph.local_graph import LocalGraph
from server.graph.node import Node
from server.graph.permissions import Identity, Role
from server.graph.services import Response
from server.moveit.actions.goal_calls import NAME, GoalCalls
from server.moveit.goals.goal_topics import Confirmation
from tests.helpers.fake_arm import HOME, settle
from tests.helpers.goal_runner import THERE
from tests.helpers.moveit import ActionDesk, translator

POINT = {"header": {"frame_id": "base_link"}, "pose": {"position": {"x": 0.25, "y": 0.05, "z": 0.15}}}
ELBOW = {"name": ["elbow_flex"], "position": [0.3]}


class Desk(ActionDesk):
    """A queue whose motions a test ends, and a client that calls."""

    def __init__(self) -> None:
        super().__init__()
        self.confirmation = Confirmation(self.graph, enabled=False, timeout_s=60.0)
        self.responses: list[Response] = []
        GoalCalls(LocalGraph(self.graph), self.queue, translator(self.arm), self.confirmation, self.context)

    async def ask(self, timeout_s: float | None = None, **request: Any) -> None:
        """Call, and let everything that it sets going come to rest."""
        self.graph.services.call(self.client, NAME, request, self.responses.append, timeout_s)
        await settle()

    @property
    def answer(self) -> dict[str, Any]:
        """The one response."""
        (response,) = self.responses
        assert response.ok, response.values
        values: dict[str, Any] = response.values
        return values

    def problem(self) -> PlanningProblem:
        """The problem of the motion that was asked for."""
        (motion,) = self.asked
        problem = motion.steps[0].problem(HOME)
        assert isinstance(problem, PlanningProblem)
        return problem


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    made = Desk()
    yield made
    await made.close()


PROPOSER = Node("agent", remote=True, identity=Identity("agent", Role.PROPOSE))


async def test_a_client_that_may_only_propose_has_one_goal_which_waits_for_approval(desk: Desk) -> None:
    desk.client = PROPOSER
    await desk.ask(named="ready")
    (motion,) = desk.asked
    assert (motion.confirm, motion.proposed) == (True, True)
    desk.client = Node("agent again", remote=True, identity=PROPOSER.identity)
    for _ in range(1000):
        await desk.ask(named="home")
    assert len(desk.asked) == 1
    assert {response.values["code_name"] for response in desk.responses} == {"CONTROL_FAILED"}
    assert "one proposed goal is taken at a time" in desk.responses[-1].values["message"]
    desk.finish()
    await settle()
    await desk.ask(named="home")
    assert len(desk.asked) == 2


async def test_a_proposal_preempts_no_motion_whatever_the_policy(desk: Desk) -> None:
    desk.queue._policy = GoalPolicy.PREEMPT
    await desk.ask(named="home")
    desk.client = PROPOSER
    await desk.ask(named="ready")
    assert len(desk.asked) == 1
    assert desk.responses == []
    desk.client = Node("operator", remote=True)
    await desk.ask(named="home")
    # The operator's goal preempts its own, and the proposal that waits behind it.
    assert [response.values["code_name"] for response in desk.responses][:1] == ["PREEMPTED"]


@pytest.mark.parametrize("confirm", [True, False])
async def test_a_goal_of_others_is_confirmed_in_that_mode_alone_and_no_plan_is(desk: Desk, *, confirm: bool) -> None:
    desk.confirmation.enabled = confirm
    await desk.ask(named="ready")
    (motion,) = desk.asked
    assert (motion.confirm, motion.proposed) == (confirm, False)
    desk.client = PROPOSER
    desk.responses.clear()
    await desk.ask(named="ready", plan_only=True)
    await until(lambda: bool(desk.responses))
    assert desk.answer["success"]
    assert len(desk.asked) == 1


GOALS: list[dict[str, Any]] = [
    {"named": "ready"},
    {"joints": ELBOW},
    {"pose": POINT},
    # Above the tip, wherever that is.
    {"pose": {"header": {"frame_id": "gripper_frame_link"}}},
]


@pytest.mark.parametrize("goal", GOALS)
async def test_a_call_is_answered_when_its_motion_has_ended(desk: Desk, goal: dict[str, Any]) -> None:
    await desk.ask(**goal)
    assert desk.responses == []
    desk.finish()
    await settle()
    assert (desk.answer["success"], desk.answer["code"], desk.answer["code_name"]) == (True, 1, "SUCCESS")
    assert (desk.answer["message"], desk.answer["goal_id"]) == (THERE.message, "1")


@pytest.mark.parametrize(
    ("request_", "got"),
    [
        ({}, "none"),
        ({"pose": {"header": {"stamp": {"sec": 1}}}}, "none"),
        ({"named": "ready", "joints": ELBOW}, "named and joints"),
        ({"named": "ready", "joints": ELBOW, "pose": POINT}, "named and joints and pose"),
        ({"joints": {"position": [0.3]}, "pose": POINT}, "joints and pose"),
    ],
)
async def test_exactly_one_goal_must_be_given(desk: Desk, request_: dict[str, Any], got: str) -> None:
    await desk.ask(**request_)
    assert desk.answer["code_name"] == "INVALID_GOAL_CONSTRAINTS"
    assert desk.answer["message"].endswith(f"exactly one of the fields named, joints and pose must be given, not {got}")
    assert desk.asked == []


@pytest.mark.parametrize(
    ("field", "value", "code", "words"),
    [
        ("velocity_scaling", 1.5, -16, "velocity_scaling must be from 0 to 1"),
        ("velocity_scaling", -0.1, -16, "velocity_scaling must be from 0 to 1"),
        ("acceleration_scaling", float("nan"), -16, "acceleration_scaling must be from 0 to 1"),
        ("optimization", "worst", -16, "optimization: Input should be 'first', 'short' or 'best', not 'worst'"),
        ("optimization_time", 10.1, -16, "optimization_time: Input should be less than or equal to 10, not 10.1"),
        ("optimization_time", -1.0, -16, "optimization_time: Input should be greater than or equal to 0, not -1.0"),
        ("allowed_planning_time", float("nan"), -16, "allowed_planning_time: Input should be"),
        ("allowed_planning_time", 61.0, -16, "allowed_planning_time: Input should be less than or equal to 60, not 61"),
        ("group", "leg", -15, "there is no planning group 'leg'"),
    ],
)
async def test_a_wrong_field_gets_its_code(desk: Desk, field: str, value: object, code: int, words: str) -> None:
    await desk.ask(named="ready", **{field: value})
    assert (desk.answer["success"], desk.answer["code"]) == (False, code)
    assert words in desk.answer["message"]


@pytest.mark.parametrize(
    ("fields", "time_s", "allowed_s"),
    [
        ({}, 0.012, 5.0),
        ({"optimization": "first"}, 0.0, 5.0),
        ({"optimization_time": 0.5}, 0.5, 5.0),
        ({"optimization": "short", "allowed_planning_time": 2.0}, 0.012, 2.0),
        ({"optimization": "best", "allowed_planning_time": 2.0}, 2.0, 2.0),
    ],
)
async def test_a_goal_chooses_the_time_of_its_planning(
    desk: Desk, fields: dict[str, object], time_s: float, allowed_s: float
) -> None:
    await desk.ask(named="ready", **fields)
    problem = desk.problem()
    assert (problem.optimization_time_s, problem.allowed_time_s) == (time_s, allowed_s)


async def test_joints_of_another_group_are_refused(desk: Desk) -> None:
    await desk.ask(group="gripper", joints=ELBOW)
    assert "no joint of group gripper is named" in desk.answer["message"]


async def test_a_call_whose_time_is_over_ends_its_motion(desk: Desk) -> None:
    await desk.ask(0.01, named="ready")
    await until(lambda: not desk.queue.busy())
    (response,) = desk.responses
    assert not response.ok
    assert "did not answer in 0.01 s" in response.values


@pytest.mark.parametrize("takes_along", [True, False])
async def test_the_goal_of_a_client_that_leaves_ends_as_the_setting_says(desk: Desk, takes_along: bool) -> None:
    desk.client.takes_goals_along = takes_along
    await desk.ask(named="ready")
    desk.graph.remove(desk.client)
    await settle()
    assert bool(desk.queue.busy()) is not takes_along


async def test_an_action_that_only_plans_can_be_cancelled(desk: Desk) -> None:
    goal = desk.graph.actions.send_goal(
        desk.client, NAME, "armbridge_msgs/MoveitGoal", {"named": "ready", "plan_only": True}, desk.results.append
    )
    assert goal is not None
    goal.cancel()
    await settle()
    assert desk.results[0].status == GoalStatus.CANCELED


async def test_a_goal_that_fails_aborts_the_action(desk: Desk) -> None:
    await desk.send(NAME, joints=ELBOW)
    desk.finish(Answer(MoveItErrorCode.CONTROL_FAILED, "stalled"))
    await settle()
    assert (desk.results[0].status, desk.results[0].values["code"]) == (GoalStatus.ABORTED, -4)


async def test_a_goal_of_another_client_is_not_ended_by_one_that_leaves(desk: Desk) -> None:
    other = Node("other", remote=True, takes_goals_along=True)
    await desk.ask(named="ready")
    desk.graph.services.call(other, NAME, {"named": "home"}, desk.responses.append)
    desk.graph.remove(other)
    await settle()
    assert desk.queue.busy()
    assert desk.queue.waiting_count == 0
