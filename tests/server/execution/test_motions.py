from __future__ import annotations

from planners.goals import JointGoal
from planners.problem import (
    CartesianPlan,
    CartesianProblem,
    Deviation,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
)
from planners.scene import EMPTY_SCENE, Scene
from server.errors import RefusedError
from server.execution.motions import Positions, Step, plan_sequence
from tests.helpers.motions import smooth_move

START = {"a": 0.0, "b": 0.5}
WALL = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "there is a wall", {"pairs": []})


def to(position_rad: float) -> Step:
    def problem(start_rad: Positions) -> PlanningProblem:
        return PlanningProblem("arm", dict(start_rad), JointGoal({"a": position_rad}))

    return problem


class Planning:
    """Goes straight; to a position beyond 1 there is no way."""

    def __init__(self, deviation: Deviation | None = None) -> None:
        self.deviation = deviation or Deviation()
        self.starts: list[Positions] = []

    async def ask(
        self, request: PlanningProblem | CartesianProblem, _scene: Scene
    ) -> Plan | CartesianPlan | PlanningFailure:
        assert isinstance(request, PlanningProblem)
        assert isinstance(request.goal, JointGoal)
        self.starts.append(request.start_rad)
        end_rad = request.goal.positions_rad["a"]
        if end_rad > 1.0:
            return WALL
        motion = smooth_move({"a": (request.start_rad["a"], end_rad)}, 1.0)
        return Plan(motion, "straight line", 0.25, deviation=self.deviation)


async def test_each_step_is_planned_from_where_the_one_before_ends() -> None:
    planning = Planning()
    planned = await plan_sequence([to(0.3), to(0.7)], START, EMPTY_SCENE, planning.ask)
    assert planning.starts == [START, {"a": 0.3, "b": 0.5}]
    assert planned.failure is None
    assert len(planned.performed.planned) == 2
    assert (planned.duration_s, planned.performed.planning_time_s) == (2.0, 0.5)
    assert planned.summary == "straight line, straight line, 2.00 s, planned in 500 ms"


async def test_the_motions_before_a_failure_are_kept_and_the_item_is_named() -> None:
    planned = await plan_sequence([to(0.3), to(2.0), to(0.1)], START, EMPTY_SCENE, Planning().ask)
    assert len(planned.performed.planned) == 1
    assert planned.failure is not None
    assert planned.failure.message == "items[1]: there is a wall"
    assert planned.failure.details == {"pairs": [], "item": 1}
    assert planned.problem is not None


async def test_the_failure_of_a_single_step_names_no_item() -> None:
    planned = await plan_sequence([to(2.0)], START, EMPTY_SCENE, Planning().ask)
    assert planned.failure == WALL


async def test_a_step_without_a_problem_is_not_planned() -> None:
    planning = Planning()

    def refusing(_start_rad: Positions) -> PlanningProblem:
        raise RefusedError(WALL)

    planned = await plan_sequence([refusing], START, EMPTY_SCENE, planning.ask)
    assert (planned.failure, planned.problem, planning.starts) == (WALL, None, [])


async def test_deviations_from_the_goal_are_noted() -> None:
    planned = await plan_sequence([to(0.3)], START, EMPTY_SCENE, Planning(Deviation(0.0, 0.5)).ask)
    assert len(planned.notes) == 1
    assert "28.6 degrees" in planned.notes[0]


async def test_half_a_cartesian_path_is_a_failure() -> None:
    async def half(_request: object, _scene: Scene) -> CartesianPlan:
        return CartesianPlan(smooth_move({"a": (0.0, 0.1)}, 1.0), 0.5, WALL, 0.1)

    assert (await plan_sequence([to(0.3)], START, EMPTY_SCENE, half)).failure == WALL
