"""The service and the action ``/moveit_goal``: on the queue, and through the executor on a graph."""

import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from harness.waiting import until
from planners.problem import MoveItErrorCode
from server.execution.goal import Answer, GoalPolicy
from server.graph.actions import GoalStatus
from server.graph.permissions import Identity, Node, Role
from server.graph.services import Response
from server.graph.topics import LocalGraph
from server.moveit.actions.goal_calls import NAME, GoalCalls
from tests.helpers.fake_arm import HOME, settle
from tests.helpers.goal_runner import THERE
from tests.helpers.moveit import ActionDesk, translator

POINT = {"header": {"frame_id": "base_link"}, "pose": {"position": {"x": 0.25, "y": 0.05, "z": 0.15}}}
ELBOW = {"name": ["elbow_flex"], "position": [0.3]}


class Desk(ActionDesk):
    """A queue whose motions a test ends, and a client that calls."""

    def __init__(self) -> None:
        super().__init__()
        self.responses: list[Response] = []
        GoalCalls(LocalGraph(self.graph), self.queue, translator(planning=self.context))

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
    desk.context.confirmation.enabled = confirm
    await desk.ask(named="ready")
    (motion,) = desk.asked
    assert (motion.confirm, motion.proposed) == (confirm, False)
    desk.client = PROPOSER
    desk.responses.clear()
    await desk.ask(named="ready", plan_only=True)
    await until(lambda: bool(desk.responses))
    assert desk.answer["success"]
    assert len(desk.asked) == 1


# The last pose is that of the tip, wherever that is.
@pytest.mark.parametrize(
    "goal",
    [{"named": "ready"}, {"joints": ELBOW}, {"pose": POINT}, {"pose": {"header": {"frame_id": "gripper_frame_link"}}}],
)
async def test_a_call_is_answered_when_its_motion_has_ended(desk: Desk, goal: dict[str, Any]) -> None:
    await desk.ask(**goal)
    assert desk.responses == []
    desk.finish()
    await settle()
    assert (desk.answer["success"], desk.answer["code"], desk.answer["code_name"]) == (True, 1, "SUCCESS")
    assert (desk.answer["message"], desk.answer["goal_id"]) == (THERE.message, "1")


EXACTLY_ONE = "exactly one of the fields named, joints and pose must be given, not "
LEAST, MOST = "must be greater than or equal to", "must be less than or equal to"
NOT_READ: list[tuple[dict[str, Any], int, str]] = [
    ({}, -16, f"{EXACTLY_ONE}none"),
    ({"pose": {"header": {"stamp": {"sec": 1}}}}, -16, f"{EXACTLY_ONE}none"),
    ({"named": "ready", "joints": ELBOW, "pose": POINT}, -16, f"{EXACTLY_ONE}named and joints and pose"),
    ({"joints": {"position": [0.3]}, "pose": POINT}, -16, f"{EXACTLY_ONE}joints and pose"),
    ({"named": "ready", "velocity_scaling": 1.5}, -16, "velocity_scaling must be from 0 to 1"),
    ({"named": "ready", "velocity_scaling": -0.1}, -16, "velocity_scaling must be from 0 to 1"),
    ({"named": "ready", "acceleration_scaling": math.nan}, -16, "acceleration_scaling must be from 0 to 1"),
    (
        {"named": "ready", "optimization": "worst"},
        -16,
        "optimization: must be 'first', 'short' or 'best', not 'worst'",
    ),
    ({"named": "ready", "optimization_time": 10.1}, -16, f"optimization_time: {MOST} 10, not 10.1"),
    ({"named": "ready", "optimization_time": -1.0}, -16, f"optimization_time: {LEAST} 0, not -1.0"),
    ({"named": "ready", "allowed_planning_time": math.nan}, -16, "allowed_planning_time: must be"),
    ({"named": "ready", "allowed_planning_time": 61.0}, -16, f"allowed_planning_time: {MOST} 60, not 61"),
    ({"named": "ready", "group": "leg"}, -15, "there is no planning group 'leg'"),
    ({"group": "gripper", "joints": ELBOW}, -16, "no joint of group gripper is named"),
]


@pytest.mark.parametrize(("request_", "code", "words"), NOT_READ)
async def test_a_wrong_request_moves_nothing(desk: Desk, request_: dict[str, Any], code: int, words: str) -> None:
    await desk.ask(**request_)
    assert (desk.answer["success"], desk.answer["code"]) == (False, code)
    assert words in desk.answer["message"]
    assert desk.asked == []


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
async def test_a_goal_chooses_its_planning_time(desk: Desk, fields: Any, time_s: float, allowed_s: float) -> None:
    await desk.ask(named="ready", **fields)
    problem = desk.asked[0].steps[0](HOME)
    assert (problem.optimization_time_s, problem.allowed_time_s) == (time_s, allowed_s)


async def test_a_call_whose_time_is_over_ends_its_motion(desk: Desk) -> None:
    await desk.ask(0.01, named="ready")
    await until(lambda: not desk.queue.busy())
    (response,) = desk.responses
    assert not response.ok
    assert "did not answer in 0.01 s" in response.values


@pytest.mark.parametrize("takes_along", [True, False])
async def test_the_goal_of_a_client_that_leaves_ends_as_the_setting_says(desk: Desk, takes_along: bool) -> None:
    desk.client.takes_goals_along, first = takes_along, desk.client
    await desk.ask(named="ready")
    # Another client that leaves ends its own goal alone.
    desk.client = Node("other", remote=True, takes_goals_along=True)
    await desk.ask(named="home")
    assert desk.queue.waiting_count == 1
    desk.graph.remove(desk.client)
    await settle()
    assert (bool(desk.queue.busy()), desk.queue.waiting_count) == (True, 0)
    desk.graph.remove(first)
    await settle()
    assert bool(desk.queue.busy()) is not takes_along


async def test_an_action_that_only_plans_can_be_cancelled_and_is_aborted_if_it_fails(desk: Desk) -> None:
    goal = desk.graph.actions.send_goal(
        desk.client, NAME, "armbridge_msgs/MoveitGoal", {"named": "ready", "plan_only": True}, desk.results.append
    )
    assert goal is not None
    goal.cancel()
    await settle()
    assert desk.results[0].status == GoalStatus.CANCELED
    await desk.send(NAME, joints=ELBOW)
    desk.finish(Answer(MoveItErrorCode.CONTROL_FAILED, "stalled"))
    await settle()
    assert (desk.results[1].status, desk.results[1].values["code"]) == (GoalStatus.ABORTED, -4)
