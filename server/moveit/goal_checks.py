"""``/check_goals``: which goals can be had, without planning or moving; many at a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from planners.problem import IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Scene
from server.errors import ServiceError
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.goal_reports import GoalReports
from server.moveit.goals import GoalTranslator
from server.moveit.motions import PlannedMotion, Positions

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
