from __future__ import annotations

from typing import Any

from planners.goals import Goal, JointGoal, PositionGoal
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Box, Pose, Scene, SceneObject
from server.moveit.alternatives import Alternatives
from tests.helpers.moveit_services import HOME, ROBOT, DirectPool

TIP = "gripper_frame_link"

# A wall beside the arm, which reaches over it in its home position.
WALL = Scene(version=31, objects=(SceneObject("wall", ((Box((0.6, 0.1, 0.6)), Pose()),), Pose((0.3, 0.25, 0.3))),))


async def found(goal: Goal) -> tuple[PlanningProblem, PlanningFailure]:
    problem = PlanningProblem("arm", HOME, goal)
    pool = DirectPool()
    failure = await pool.ask(problem, WALL)
    assert isinstance(failure, PlanningFailure)
    return problem, await Alternatives(ROBOT, pool).added(failure, problem, WALL)  # type: ignore[arg-type]


async def planned(goal: Goal) -> Any:
    return await DirectPool().ask(PlanningProblem("arm", HOME, goal), WALL)


async def test_a_joint_goal_in_collision_comes_with_a_free_one_that_can_be_planned() -> None:
    _, failure = await found(JointGoal({"shoulder_pan": -1.2}))
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert failure.details["pairs"]
    assert isinstance(await planned(JointGoal(failure.details["free_rad"])), Plan)


async def test_a_point_in_collision_comes_with_a_free_one_that_can_be_planned() -> None:
    _, failure = await found(PositionGoal(TIP, (0.25, 0.25, 0.2), 0.01))
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert isinstance(await planned(PositionGoal(TIP, tuple(failure.details["free_m"]), 0.01)), Plan)


async def test_other_failures_stay_as_they_are() -> None:
    failure = PlanningFailure(MoveItErrorCode.TIMED_OUT, "late")
    alternatives = Alternatives(ROBOT, DirectPool())  # type: ignore[arg-type]
    assert await alternatives.added(failure, PlanningProblem("arm", HOME, JointGoal({})), WALL) is failure
    in_collision = PlanningFailure(MoveItErrorCode.GOAL_IN_COLLISION, "touches")
    assert await alternatives.added(in_collision, None, WALL) is in_collision
