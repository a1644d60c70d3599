import asyncio

import pytest

from planners.goals import JointGoal
from planners.problem import CartesianProblem, Line, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Box, Pose, Scene, SceneObject
from server.execution import failures
from server.execution.failures import with_nearest_goal
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import DirectPool

FAILURE = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "the goal touches the box")
TIP = "gripper_frame_link"
# A wall beside the arm, which reaches over it in its home position.
WALL = Scene(version=31, objects=(SceneObject("wall", ((Box((0.6, 0.1, 0.6)), Pose()),), Pose((0.3, 0.25, 0.3))),))


async def test_a_path_of_the_tip_gets_the_end_that_is_reached_and_says_if_its_own_end_is_by_another_way() -> None:
    pool, problem = DirectPool(), CartesianProblem("arm", HOME, TIP, (Line(Pose((0.3, 0.3, 0.2))),))
    plan = await pool.ask(problem, WALL)
    failure = await with_nearest_goal(plan.stopped_by, problem, WALL, pool)  # type: ignore[arg-type, union-attr]
    assert failure.code is plan.stopped_by.code  # type: ignore[union-attr]
    details = failure.details
    assert details["pairs"]
    assert 0.0 < details["free_fraction"] < 1.0
    assert details["end_by_other_way"] is False
    assert "what would work: the same path to (" in failure.message
    cm = 100.0 * details["length_m"]
    assert f" m, {details['free_fraction'] * cm:.1f} of {cm:.1f} cm" in failure.message
    assert "by a motion that does not follow it" not in failure.message
    end = Pose(tuple(details["free_m"]), tuple(details["free_orientation"]))
    part = await pool.ask(CartesianProblem("arm", HOME, TIP, (Line(end),)), WALL)
    assert part.stopped_by is None  # type: ignore[union-attr]


async def test_the_end_of_a_path_that_cannot_begin_may_be_had_by_another_way() -> None:
    pool = DirectPool()
    problem = CartesianProblem("arm", HOME, TIP, (Line(Pose((0.3, 0.0, 0.2))),), max_joint_step_rad=1e-9)
    plan = await pool.ask(problem, WALL)
    failure = await with_nearest_goal(plan.stopped_by, problem, WALL, pool)  # type: ignore[arg-type, union-attr]
    assert failure.message.endswith("; what would work: its end by a motion that does not follow it")
    assert failure.details["end_by_other_way"] is True
    assert "free_m" not in failure.details


async def test_a_goal_to_which_no_motion_was_found_gets_the_nearest_that_one_reaches() -> None:
    late = PlanningFailure(MoveItErrorCode.TIMED_OUT, "late", {"allowed_time_s": 5.0})
    problem = PlanningProblem("arm", HOME, JointGoal({"shoulder_pan": -1.2}))
    failure = await with_nearest_goal(late, problem, WALL, DirectPool())  # type: ignore[arg-type]
    assert (failure.code, failure.message) == (late.code, late.message)
    assert failure.details["allowed_time_s"] == 5.0
    assert failure.details["free_rad"]["shoulder_pan"] < 0.0
    nearest = PlanningProblem("arm", HOME, JointGoal(failure.details["free_rad"]))
    assert isinstance(await DirectPool().ask(nearest, WALL), Plan)


@pytest.mark.parametrize(("position_rad", "asked"), [(-1.0, False), (1.0, False), (-1.001, True), (1.001, True)])
async def test_a_goal_is_asked_about_where_it_is_beyond_limits_and_not_for_its_constraints(
    position_rad: float, asked: bool
) -> None:
    details = {"joint": "shoulder_pan", "lower_rad": -1.0, "upper_rad": 1.0}
    failure = PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "the range of the constraint", details)
    pool = DirectPool()
    problem = PlanningProblem("arm", HOME, JointGoal({"shoulder_pan": position_rad}))
    answer = await with_nearest_goal(failure, problem, Scene(), pool)  # type: ignore[arg-type]
    assert (len(pool.requests), answer is failure) == (asked, not asked)


async def test_a_failure_does_not_wait_for_planners_that_are_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    class BusyPool:
        async def ask(self, _request: object, _scene: Scene) -> None:
            await asyncio.Event().wait()

    monkeypatch.setattr(failures, "ASKING_TIMEOUT_S", 0.01)
    problem = PlanningProblem("arm", HOME, JointGoal({"shoulder_pan": -1.2}))
    assert await with_nearest_goal(FAILURE, problem, WALL, BusyPool()) is FAILURE  # type: ignore[arg-type]
