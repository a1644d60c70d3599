from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planners.goals import JointGoal
from planners.problem import JointPathProblem, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from server.errors import RefusedError
from server.execution.motions import ExternalTrajectory, Motion, PlannedMotion, Positions, Problem
from server.execution.planned_ahead import LONGEST_OPTIMIZATION_S, OPTIMIZATION_SHARE, PlannedAhead
from tests.helpers.fake_arm import HOME, settle
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

ARM = so101().groups["arm"].joints
SCENE = Scene(1)
NO_WAY = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "there is no way")

# Where the motion in progress ends, and the start of a motion after it.
END = dict.fromkeys(ARM, 0.2)
START = {**HOME, **END}


def problem_from(start_rad: Positions) -> PlanningProblem:
    return PlanningProblem("arm", start_rad, JointGoal({"shoulder_pan": 0.9}))


def plan_of(duration_s: float, method: str = "straight line") -> Plan:
    return Plan(smooth_move(dict.fromkeys(ARM, (0.2, 0.9)), duration_s), method, 0.01)


def goal(step: Callable[[Positions], Problem] = problem_from) -> PlannedMotion:
    return PlannedMotion((step,), frozenset(ARM))


class Planners:
    """Planners that answer what they are told to, and in the background so many times as they are told to.

    Attributes:
        answers: in the background, the first one first.
        asked: problems that were due.
        background: problems in the background.
        ready: so many of those are answered.
        given_up: number of those that were cancelled.
    """

    def __init__(self) -> None:
        self.answers: list[Plan | PlanningFailure | None] = []
        self.ready = 100
        self.asked: list[Problem] = []
        self.background: list[PlanningProblem] = []
        self.given_up = 0

    async def ask(self, problem: Problem, _scene: Scene) -> Plan:
        self.asked.append(problem)
        return plan_of(5.0, "planned in its turn")

    async def ask_in_background(self, problem: PlanningProblem, _scene: Scene) -> Any:
        self.background.append(problem)
        try:
            while len(self.background) > self.ready:
                await asyncio.sleep(0)
        except asyncio.CancelledError:
            self.given_up += 1
            raise
        return self.answers.pop(0) if self.answers else plan_of(1.0)


class Desk:
    """A plan made in advance, and its planners."""

    def __init__(self) -> None:
        self.planners = Planners()
        self.ahead = PlannedAhead(self.planners)  # type: ignore[arg-type]

    async def begin(self, request: Motion, scene: Scene = SCENE, left_s: float = 60.0, **end_rad: float) -> None:
        self.ahead.begin(request, HOME, {**END, **end_rad}, scene, left_s)
        await settle()

    async def ask(self, problem: Problem, scene: Scene = SCENE) -> Plan:
        answer = await self.ahead.ask(problem, scene)
        assert isinstance(answer, Plan)
        return answer


@pytest.fixture
async def desk() -> Desk:
    return Desk()


OTHER: dict[str, tuple[Problem, Scene]] = {
    "another start": (problem_from({**START, "shoulder_pan": np.nextafter(0.2, 1.0)}), SCENE),
    "another joint elsewhere": (problem_from({**START, "gripper": 1e-9}), SCENE),
    "another goal": (replace(problem_from(START), goal=JointGoal({"shoulder_pan": 0.8})), SCENE),
    "other limits": (replace(problem_from(START), velocity_scaling=0.5), SCENE),
    "other settings": (replace(problem_from(START), attempts=6), SCENE),
    "another scene": (problem_from(START), Scene(2)),
    "another kind": (JointPathProblem(START, ARM, np.arange(2.0), np.zeros((2, len(ARM)))), SCENE),
}


@pytest.mark.parametrize(("problem", "scene"), OTHER.values(), ids=OTHER.keys())
async def test_any_other_problem_is_planned_in_its_turn(desk: Desk, problem: Problem, scene: Scene) -> None:
    await desk.begin(goal())
    assert (await desk.ask(problem, scene)).method == "planned in its turn"
    assert desk.planners.asked == [problem]


async def test_a_goal_is_planned_ahead_anew_when_the_scene_has_changed(desk: Desk) -> None:
    request = goal()
    await desk.begin(request)
    await desk.begin(request, Scene(2))
    assert (await desk.ask(problem_from(START), Scene(2))).method == "straight line, in advance"


async def test_a_plan_that_is_cancelled_is_given_up_and_not_used(desk: Desk) -> None:
    desk.planners.ready = 0
    await desk.begin(goal())
    desk.ahead.cancel()
    desk.planners.ready = 1
    await settle()
    assert desk.planners.given_up == 1
    assert (await desk.ask(problem_from(START))).method == "planned in its turn"


async def test_the_plan_stays_when_another_goal_leaves_the_queue(desk: Desk) -> None:
    await desk.begin(goal())
    desk.ahead.forget(goal())
    assert (await desk.ask(problem_from(START))).method == "straight line, in advance"


@pytest.mark.parametrize("code", [MoveItErrorCode.PLANNING_FAILED, MoveItErrorCode.CRASH, MoveItErrorCode.TIMED_OUT])
async def test_a_goal_that_cannot_be_planned_ahead_is_planned_in_its_turn(desk: Desk, code: MoveItErrorCode) -> None:
    request = goal()
    desk.planners.answers = [PlanningFailure(code, "not yet")]
    for _ in range(2):
        await desk.begin(request)
    assert len(desk.planners.background) == 1
    assert (await desk.ask(problem_from(START))).method == "planned in its turn"


async def test_planners_that_had_something_else_to_plan_are_asked_again(desk: Desk) -> None:
    request = goal()
    desk.planners.answers = [None]
    for _ in range(2):
        await desk.begin(request)
    assert (await desk.ask(problem_from(START))).method == "straight line, in advance"


def refused(_start_rad: Positions) -> PlanningProblem:
    raise RefusedError(NO_WAY)


def broken(_start_rad: Positions) -> PlanningProblem:
    raise ValueError("a bug")


NOT_AHEAD: dict[str, Motion] = {
    "a trajectory": ExternalTrajectory(lambda *_start: plan_of(1.0).trajectory, frozenset(ARM)),
    "several motions": PlannedMotion((problem_from, problem_from), frozenset(ARM)),
    "a scene of its own": replace(goal(), scene=lambda _positions_rad: Scene(7)),
    "a user confirms it": replace(goal(), confirm=True),
    "a given path": goal(lambda now_rad: JointPathProblem(now_rad, ARM, np.arange(2.0), np.zeros((2, len(ARM))))),
    "it is refused": goal(refused),
}


@pytest.mark.parametrize("request_", NOT_AHEAD.values(), ids=NOT_AHEAD.keys())
async def test_goals_that_are_not_planned_ahead(desk: Desk, request_: Motion, caplog: pytest.LogCaptureFixture) -> None:
    await desk.begin(request_)
    assert desk.planners.background == []
    assert caplog.text == ""


async def test_a_bug_in_a_goal_costs_no_more_than_its_plan(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    await desk.begin(goal(broken))
    assert "planning ahead failed" in caplog.text
    assert (await desk.ask(problem_from(START))).method == "planned in its turn"


@pytest.mark.parametrize("method", ["RRTConnect", "via point"])
async def test_the_time_left_is_spent_on_a_shorter_motion(desk: Desk, method: str) -> None:
    desk.planners.answers = [plan_of(3.0, method), plan_of(2.0, method)]
    await desk.begin(goal())
    assert [problem.optimization_time_s for problem in desk.planners.background] == [
        PlanningProblem.optimization_time_s,
        LONGEST_OPTIMIZATION_S,
    ]
    plan = await desk.ask(problem_from(START))
    assert plan.trajectory.duration_s == 2.0
    assert plan.planning_time_s == 0.02


@pytest.mark.parametrize("second", [plan_of(4.0, "RRTConnect"), NO_WAY, None], ids=["longer", "not found", "given up"])
async def test_the_first_plan_stays_unless_a_shorter_one_is_found(
    desk: Desk, second: Plan | PlanningFailure | None
) -> None:
    desk.planners.answers = [plan_of(3.0, "RRTConnect"), second]
    await desk.begin(goal())
    assert len(desk.planners.background) == 2
    assert (await desk.ask(problem_from(START))).trajectory.duration_s == 3.0


async def test_the_first_plan_is_used_when_the_turn_comes_while_it_is_shortened(desk: Desk) -> None:
    desk.planners.answers, desk.planners.ready = [plan_of(3.0, "RRTConnect")], 1
    await desk.begin(goal())
    assert (await desk.ask(problem_from(START))).trajectory.duration_s == 3.0


async def test_no_more_than_a_share_of_the_time_left_is_spent(desk: Desk) -> None:
    desk.planners.answers = [plan_of(3.0, "RRTConnect")]
    await desk.begin(goal(), left_s=0.2)
    assert desk.planners.background[-1].optimization_time_s <= OPTIMIZATION_SHARE * 0.2
