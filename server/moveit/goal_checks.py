"""Check of many goals by ``/check_goals``, without planning or moving."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from planners.problem import IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Pose, Scene
from robot.forward import ForwardPlacements
from robot.model import RobotModel
from robot.trapezoid import rest_to_rest
from server.errors import ServiceError
from server.execution.motions import PlannedMotion, Positions
from server.graph import Graph
from server.moveit.goal_messages import GoalTranslator
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import matrix_of
from server.node import Node

SERVICE = "/check_goals"

MAX_GOALS = 100

# The planners' time for a goal on average, of 5 ms in all, and what they search at first: most need a millisecond.
GOAL_TIME_S = 0.004
FIRST_LOOK_S = 0.003

# Few goals have time for the nearest point as well, where a gizmo out of reach is drawn; 20 times a second is smooth.
LEAST_CALL_S = 0.04

# What is left of a call's time goes to the goals that have no answer yet: to say why one cannot be had may take a tenth
# of a second. The way to the planner and back comes on top, and shorter looks than this tell nothing.
WAY_S = 0.002
LEAST_LOOK_S = 0.003

# Others ask the planners too; a call that has waited so long for its turns is answered with what it has.
WAITING_S = 2.0

NOT_ASKED = PlanningFailure(
    MoveItErrorCode.TIMED_OUT, f"not looked at: the planners were busy for {WAITING_S:g} s, ask again"
)


# In place of distances and times that nobody knows.
NOT_KNOWN = -1.0


class Asks(Protocol):
    """Answers questions, as `planners.pool.PlannerPool` does."""

    async def ask(self, request: IkQuestion, scene: Scene, /) -> IkAnswer | PlanningFailure:
        """Find configurations in a scene."""


class ShownScene(Protocol):
    """The planning scene."""

    @property
    def scene(self) -> Scene:
        """As it is now."""


class GoalChecks:
    """Offers the service.

    Args:
        graph: where it is.
        reports: write the answers.
    """

    def __init__(self, graph: Graph, reports: GoalReports) -> None:
        self._graph = graph
        self._reports = reports
        self._node = Node("goal checks")

    def open(
        self, translator: GoalTranslator, present: Callable[[], Positions | None], pool: Asks, scene: ShownScene
    ) -> None:
        """Offer.

        Args:
            translator: reads goals as those of ``/moveit_goal_*``.
            present: position of every movable joint now [rad], None while it is not known.
            pool: answers questions.
            scene: what is in the way.
        """

        async def serve(request: dict[str, Any]) -> dict[str, Any]:
            poses, joints = request["poses"], request["joints"]
            if len(poses) + len(joints) > MAX_GOALS:
                raise ServiceError(f"poses and joints: {len(poses) + len(joints)} goals, the limit is {MAX_GOALS}")
            present_rad = present()
            if present_rad is None:
                raise ServiceError("where the arm is is not known: it is not connected")
            problems = [_problem(translator.pose(each), present_rad) for each in poses]
            problems += [_problem(translator.joints(each), present_rad) for each in joints]
            answers = await answers_in_time(problems, pool, scene.scene)
            wishes = [translator.pose_in_root(each, present_rad) for each in poses] + [None] * len(joints)
            reports = [self._reports.report(present_rad, *each) for each in zip(answers, wishes, strict=True)]
            return {"results": reports}

        self._graph.services.offer(self._node, SERVICE, "armbridge_msgs/CheckGoals", serve)


def _problem(motion: PlannedMotion | PlanningFailure, present_rad: Positions) -> PlanningProblem | PlanningFailure:
    """What would be planned for a goal from here."""
    if isinstance(motion, PlanningFailure):
        return motion
    match motion.steps[0](present_rad):
        case PlanningProblem() | PlanningFailure() as problem:
            return problem
        case other:
            raise AssertionError(f"a goal of the simple layer asks for {other}")


async def answers_in_time(
    problems: list[PlanningProblem | PlanningFailure], pool: Asks, scene: Scene
) -> list[IkAnswer | PlanningFailure]:
    """Answer all goals: each gets a short look, then those without an answer what is left of the time.

    Args:
        problems: of the goals, or why there is none.
        pool: answers questions.
        scene: what is in the way.
    """
    until_s = time.monotonic() + max(GOAL_TIME_S * len(problems), LEAST_CALL_S)
    answers = []
    for problem in problems:
        late = time.monotonic() > until_s + WAITING_S
        answers.append(NOT_ASKED if late else await _look(problem, FIRST_LOOK_S, pool, scene))
    undecided = [at for at, answer in enumerate(answers) if _undecided(answer)]
    for done, at in enumerate(undecided):
        share_s = (until_s - time.monotonic()) / (len(undecided) - done) - WAY_S
        if share_s < LEAST_LOOK_S:
            break
        answers[at] = await _look(problems[at], share_s, pool, scene)
    return answers


def _undecided(answer: IkAnswer | PlanningFailure) -> bool:
    return isinstance(answer, PlanningFailure) and answer.code is MoveItErrorCode.TIMED_OUT and answer is not NOT_ASKED


async def _look(
    problem: PlanningProblem | PlanningFailure, allowed_s: float, pool: Asks, scene: Scene
) -> IkAnswer | PlanningFailure:
    if isinstance(problem, PlanningFailure):
        return problem
    question = IkQuestion(problem.group, problem.start_rad, problem.goal, allowed_time_s=allowed_s)
    return await pool.ask(question, scene)


class GoalReports:
    """Writes the messages.

    Args:
        robot: the arm.
        parameters: how goals are planned.
        tip: the link that pose goals are for.
    """

    def __init__(self, robot: RobotModel, parameters: MoveItParameters, tip: str) -> None:
        self._joints = [robot.joints[name] for name in robot.groups[parameters.group_name].joints]
        self._parameters = parameters
        self._tip = tip
        self._forward = ForwardPlacements(robot)

    def report(
        self, start_rad: Positions, answer: IkAnswer | PlanningFailure, wish: Pose | PlanningFailure | None
    ) -> dict[str, Any]:
        """Tell of one goal.

        Args:
            start_rad: where the joints are [rad].
            answer: what was found.
            wish: the pose that was asked for, in the root link; None for a joint goal.
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
            "orientation_error_rad": self._turned_rad(positions_rad, wish) if isinstance(wish, Pose) else 0.0,
            "duration_s": self._duration_s(start_rad, positions_rad),
            "solution": {"name": list(positions_rad), "position": list(positions_rad.values())},
        }

    def _turned_rad(self, positions_rad: Positions, wish: Pose) -> float:
        """The rotation between the tip and the wish [rad]."""
        tip = self._forward.transforms(positions_rad)[self._tip]
        turn = tip[:3, :3].T @ matrix_of(wish)[:3, :3]
        return math.acos(float(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))

    def _duration_s(self, start_rad: Positions, end_rad: Positions) -> float:
        """What the slowest joint takes when nothing is in the way [s]."""
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
        # What cannot be had without touching something can be reached all the same.
        "reachable": failure.code is MoveItErrorCode.GOAL_IN_COLLISION,
        "free": False,
        "decided": failure.code is not MoveItErrorCode.TIMED_OUT,
        "position_error_m": float(failure.details.get("distance_m", NOT_KNOWN)),
        "orientation_error_rad": NOT_KNOWN,
        "duration_s": NOT_KNOWN,
        "solution": {"name": list(nearest_rad), "position": list(nearest_rad.values())},
    }
