"""Check of many goals by ``/check_goals``, without planning or moving."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from planners.problem import IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Pose, Scene
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.trajectory import rest_to_rest
from server.errors import RefusedError, ServiceError
from server.execution.motions import PlannedMotion, Positions
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.goal_messages import GoalTranslator, Message, PositionSource
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import matrix_of

SERVICE = "/check_goals"

MAX_GOALS = 100

# The planners' time for a goal on average, of 5 ms in all, and what they search at first: most need a millisecond.
GOAL_TIME_S = 0.004
FIRST_CHECK_S = 0.003

# Few goals have time for the nearest point as well, where a gizmo out of reach is drawn; 20 times a second is smooth.
MIN_CALL_S = 0.04

# The rest of a call's time goes to the goals that have no answer yet: to find the reason of a failure may take a tenth
# of a second. The way to the planner and back comes on top, and shorter checks than this find nothing.
WAY_S = 0.002
MIN_CHECK_S = 0.003

# Other calls ask the planners too; a call that has waited so long for its turns is answered with what it has.
WAITING_S = 2.0

NOT_CHECKED = PlanningFailure(
    MoveItErrorCode.TIMED_OUT, f"not looked at: the planners were busy for {WAITING_S:g} s, ask again"
)

# In place of unknown distances and times.
UNKNOWN = -1.0


class IkPlanner(Protocol):
    """Planner of configurations, as `planners.pool.PlannerPool`."""

    async def ask(self, request: IkQuestion, scene: Scene, /) -> IkAnswer | PlanningFailure:
        """Find configurations in a scene."""


class CurrentScene(Protocol):
    """The planning scene, as `server.moveit.scene.scene_state.SceneState`."""

    @property
    def scene(self) -> Scene:
        """The present scene."""


class GoalChecks:
    """The service ``/check_goals``.

    Args:
        graph: where it is.
        reports: write the results.
        translator: reads goals as those of ``/moveit_goal_*``.
        current: the positions of the arm.
        pool: the planners.
        scene: the planning scene.
    """

    def __init__(
        self,
        graph: Graph,
        reports: GoalReports,
        translator: GoalTranslator,
        current: PositionSource,
        pool: IkPlanner,
        scene: CurrentScene,
    ) -> None:
        self._graph = graph
        self._reports = reports
        self._translator = translator
        self._current = current
        self._pool = pool
        self._scene = scene
        self._node = Node("goal checks")

    def open(self) -> None:
        """Offer the service."""
        self._graph.services.offer(self._node, SERVICE, "armbridge_msgs/CheckGoals", self._check)

    async def _check(self, request: dict[str, Any]) -> dict[str, Any]:
        poses, joints = request["poses"], request["joints"]
        if len(poses) + len(joints) > MAX_GOALS:
            raise ServiceError(f"poses and joints: {len(poses) + len(joints)} goals, the limit is {MAX_GOALS}")
        present_rad = self._current.positions_rad()
        if present_rad is None:
            raise ServiceError("where the arm is is not known: it is not connected")
        problems = [_problem(self._translator.pose, each, present_rad) for each in poses]
        problems += [_problem(self._translator.joints, each, present_rad) for each in joints]
        answers = await answers_in_time(problems, self._pool, self._scene.scene)
        wanted = [self._wanted_pose(each, present_rad) for each in poses] + [None] * len(joints)
        results = [self._reports.report(present_rad, *each) for each in zip(answers, wanted, strict=True)]
        return {"results": results}

    def _wanted_pose(self, message: Message, present_rad: Positions) -> Pose | None:
        try:
            return self._translator.pose_in_root(message, present_rad)
        except RefusedError:
            return None


def _problem(
    translate: Callable[[Message], PlannedMotion], message: Message, present_rad: Positions
) -> PlanningProblem | PlanningFailure:
    """Return the problem that would be planned for a goal from here, or the reason why there is none."""
    try:
        problem = translate(message).steps[0](present_rad)
    except RefusedError as error:
        return error.failure
    match problem:
        case PlanningProblem():
            return problem
        case other:
            raise AssertionError(f"a goal message asks for {other}")


async def answers_in_time(
    problems: list[PlanningProblem | PlanningFailure], pool: IkPlanner, scene: Scene
) -> list[IkAnswer | PlanningFailure]:
    """Answer all goals: each gets a short check, then those without an answer share the rest of the time.

    Args:
        problems: of the goals, or the reasons why there is none.
        pool: the planners.
        scene: to check in.
    """
    until_s = time.monotonic() + max(GOAL_TIME_S * len(problems), MIN_CALL_S)
    answers = []
    for problem in problems:
        late = time.monotonic() > until_s + WAITING_S
        answers.append(NOT_CHECKED if late else await _find(problem, FIRST_CHECK_S, pool, scene))
    undecided = [at for at, answer in enumerate(answers) if _undecided(answer)]
    for done, at in enumerate(undecided):
        share_s = (until_s - time.monotonic()) / (len(undecided) - done) - WAY_S
        if share_s < MIN_CHECK_S:
            break
        answers[at] = await _find(problems[at], share_s, pool, scene)
    return answers


def _undecided(answer: IkAnswer | PlanningFailure) -> bool:
    return (
        isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.TIMED_OUT and answer is not NOT_CHECKED
    )


async def _find(
    problem: PlanningProblem | PlanningFailure, allowed_s: float, pool: IkPlanner, scene: Scene
) -> IkAnswer | PlanningFailure:
    if isinstance(problem, PlanningFailure):
        return problem
    question = IkQuestion(problem.group, problem.start_rad, problem.goal, allowed_time_s=allowed_s)
    return await pool.ask(question, scene)


class GoalReports:
    """Writer of armbridge_msgs/GoalCheck messages.

    Args:
        robot: the arm.
        parameters: of planning.
        tip: the link that pose goals are for.
    """

    def __init__(self, robot: RobotModel, parameters: MoveItParameters, tip: str) -> None:
        self._joints = [robot.joints[name] for name in robot.groups[parameters.group_name].joints]
        self._parameters = parameters
        self._tip = tip
        self._forward = ForwardPlacements(robot)

    def report(self, start_rad: Positions, answer: IkAnswer | PlanningFailure, wanted: Pose | None) -> dict[str, Any]:
        """Return the message for one goal.

        Args:
            start_rad: positions of the joints [rad].
            answer: of the planners.
            wanted: the goal pose in the root link; None for a joint goal.
        """
        if isinstance(answer, PlanningFailure):
            return _refused(answer)
        positions_rad = answer.positions_rad[0]
        return {
            "code": int(MoveItErrorCode.SUCCESS),
            "reachable": True,
            "free": True,
            "decided": True,
            "position_error_m": answer.deviations[0].position_m,
            "orientation_error_rad": self._angle_rad(positions_rad, wanted) if wanted is not None else 0.0,
            "duration_s": self._duration_s(start_rad, positions_rad),
            "solution": {"name": list(positions_rad), "position": list(positions_rad.values())},
        }

    def _angle_rad(self, positions_rad: Positions, wanted: Pose) -> float:
        """Return the angle between the tip and the wanted pose [rad]."""
        tip = self._forward.transforms(positions_rad)[self._tip]
        turn = tip[:3, :3].T @ matrix_of(wanted)[:3, :3]
        return math.acos(float(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))

    def _duration_s(self, start_rad: Positions, end_rad: Positions) -> float:
        """Return the duration of the slowest joint when nothing is in the way [s]."""
        return max(
            rest_to_rest(
                joint.name,
                start_rad[joint.name],
                end_rad[joint.name],
                self._parameters.max_velocity_scaling * joint.max_velocity,
                self._parameters.max_acceleration_scaling * joint.max_acceleration,
            ).duration_s
            for joint in self._joints
        )


def _refused(failure: PlanningFailure) -> dict[str, Any]:
    nearest_rad: Mapping[str, float] = failure.details.get("nearest_rad", {})
    return {
        "code": int(failure.code),
        "message": failure.message,
        # A goal in collision is within reach all the same.
        "reachable": failure.code is MoveItErrorCode.GOAL_IN_COLLISION,
        "free": False,
        "decided": failure.code is not MoveItErrorCode.TIMED_OUT,
        "position_error_m": float(failure.details.get("distance_m", UNKNOWN)),
        "orientation_error_rad": UNKNOWN,
        "duration_s": UNKNOWN,
        "solution": {"name": list(nearest_rad), "position": list(nearest_rad.values())},
    }
