"""Check of many goals of topics at once, without planning or moving: the service ``/check_goals``."""

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.interface import Planners
from planners.problem import IkAnswer, IkQuestion, MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Pose, Scene
from protocol.messages import ListLimits
from robot.trajectory import rest_to_rest
from server.errors import RefusedError, ServiceError
from server.execution.motions import Positions
from server.graph.permissions import PLANNING
from server.graph.topics import Graph
from server.moveit.goals.goal_topics import JOINTS_TOPIC, POSE_TOPIC, GoalTranslator
from server.moveit.messages import Message, matrix_of
from server.moveit.requests.planning_context import PlanningContext

SERVICE = "/check_goals"

MAX_GOALS = 100

# Time of the planners for a goal on average, of 5 ms in all: most need a millisecond.
GOAL_TIME_S = 0.004

# Few goals have time for the nearest point as well, where a gizmo out of reach is drawn; 20 times a second is smooth.
MIN_CALL_S = 0.04

# The way to the planner and back takes time as well, and checks shorter than the least find nothing.
WAY_S = 0.002
MIN_CHECK_S = 0.003

# Other calls ask the planners too: after waiting for its turns this long, a call is answered with the results so far.
WAITING_S = 2.0

NOT_CHECKED = PlanningFailure(
    MoveItErrorCode.TIMED_OUT, f"not looked at: the planners were busy for {WAITING_S:g} s, ask again"
)

# In place of unknown distances and times.
UNKNOWN = -1.0


def offer_goal_checks(graph: Graph, translator: GoalTranslator) -> None:
    planning, turn = translator.planning, asyncio.Lock()

    async def check(request: dict[str, Any]) -> dict[str, Any]:
        poses, joints = request["poses"], request["joints"]
        if len(poses) + len(joints) > MAX_GOALS:
            raise ServiceError(f"poses and joints: {len(poses) + len(joints)} goals, the limit is {MAX_GOALS}")
        present_rad = planning.current.positions_rad()
        if present_rad is None:
            raise ServiceError("joint positions unknown: the arm is not connected")
        problems, results, tip = [], [], translator.tip
        # Each goal takes part of a millisecond; others have their turn in between, and other calls theirs afterwards.
        async with turn:
            for topic, messages in ((POSE_TOPIC, poses), (JOINTS_TOPIC, joints)):
                for each in messages:
                    await asyncio.sleep(0)
                    problems.append(_problem(translator, topic, each, present_rad))
        await planning.scene_state.settled()
        answers = await answers_in_time(problems, planning.pool, planning.scene_state.scene)
        async with turn:
            for answer, message in itertools.zip_longest(answers, poses):
                await asyncio.sleep(0)
                desired = None
                if message is not None:
                    with contextlib.suppress(RefusedError):
                        desired = translator.pose_in_root(message, present_rad)
                results.append(goal_check(planning, present_rad, answer, tip, desired))
        return {"results": results}

    # Each may be the only ones; both together are counted in the call.
    limits = ListLimits({f"armbridge_msgs/srv/CheckGoals_Request.{field}": MAX_GOALS for field in ("poses", "joints")})
    node = graph.node("goal checks")
    node.offer(SERVICE, "armbridge_msgs/CheckGoals", check, limits=limits, rule=PLANNING)


def _problem(
    translator: GoalTranslator, topic: str, message: Message, present_rad: Positions
) -> PlanningProblem | PlanningFailure:
    try:
        problem = translator.motion(topic, message).steps[0](present_rad)
    except RefusedError as error:
        return error.failure
    match problem:
        case PlanningProblem():
            return problem
        case other:
            raise AssertionError(f"a goal message asks for {other}")


async def answers_in_time(
    problems: list[PlanningProblem | PlanningFailure], pool: Planners, scene: Scene
) -> list[IkAnswer | PlanningFailure]:
    """Answer all goals: each may take its share of the time left, and quick goals leave theirs to the later ones."""
    until_s = time.monotonic() + max(GOAL_TIME_S * len(problems), MIN_CALL_S)
    answers: list[IkAnswer | PlanningFailure] = []
    for done, problem in enumerate(problems):
        left_s = until_s - time.monotonic()
        share_s = max(left_s / (len(problems) - done) - WAY_S, MIN_CHECK_S)
        if left_s < -WAITING_S:
            answers.append(NOT_CHECKED)
        elif isinstance(problem, PlanningFailure):
            answers.append(problem)
        else:
            question = IkQuestion(problem.group, problem.start_rad, problem.goal, allowed_time_s=share_s)
            answers.append(await pool.ask(question, scene))
    return answers


def goal_check(
    planning: PlanningContext, start_rad: Positions, answer: IkAnswer | PlanningFailure, tip: str, desired: Pose | None
) -> dict[str, Any]:
    """Return the armbridge_msgs/GoalCheck of one goal; its pose is in the root link, and None for a joint goal."""
    if isinstance(answer, PlanningFailure):
        return _refused(answer)
    end_rad, angle_rad = answer.positions_rad[0], 0.0
    if desired is not None:
        found = planning.scene_state.links(end_rad).pose(tip)
        turn = matrix_of(found)[:3, :3].T @ matrix_of(desired)[:3, :3]
        angle_rad = math.acos(float(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    parameters = planning.parameters.configured
    # The slowest joint's, when nothing is in the way.
    duration_s = max(
        rest_to_rest(
            joint.name,
            start_rad[joint.name],
            end_rad[joint.name],
            parameters.max_velocity_scaling * joint.max_velocity,
            parameters.max_acceleration_scaling * joint.max_acceleration,
        ).duration_s
        for joint in planning.robot.movable_joints
    )
    return {
        "code": int(MoveItErrorCode.SUCCESS),
        "reachable": True,
        "free": True,
        "decided": True,
        "position_error_m": answer.deviations[0].position_m,
        "orientation_error_rad": angle_rad,
        "duration_s": duration_s,
        "solution": {"name": list(end_rad), "position": list(end_rad.values())},
    }


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
