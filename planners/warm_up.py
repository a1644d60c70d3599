"""First plans of a planner, which take longer than all that follow, made before a request waits for them."""

from __future__ import annotations

import logging

import numpy as np

from planners.goals import JointGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import CartesianProblem, Line, PlanningProblem, Request
from planners.scene import Pose
from robot.description.model import RobotModel

log = logging.getLogger("armbridge.planner")

# Travel of each joint [rad], and of the tip [m].
STEP_RAD = 0.2
STEP_M = 0.02


def warm_up(planner: Planner, robot: RobotModel) -> None:
    """Plan a joint goal, a goal of the tip and a path of the tip, and drop the answers."""
    for request in _requests(planner, robot):
        try:
            planner.answer(request)
        except Exception:
            # A bug that shows here shows with the goals as well, which are answered with it.
            log.exception("the first plans failed on %r", request)


def _requests(planner: Planner, robot: RobotModel) -> list[Request]:
    group = robot.groups[robot.default_group]
    states = robot.named_states.get(group.name, {})
    start = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in robot.movable_joints}
    start |= next(iter(states.values()), {})
    end = {}
    for name in group.joints:
        joint = robot.joints[name]
        away = STEP_RAD if joint.upper - start[name] > STEP_RAD else -STEP_RAD
        end[name] = float(np.clip(start[name] + away, joint.lower, joint.upper))
    requests: list[Request] = [PlanningProblem(group.name, start, JointGoal(end))]
    if robot.tip_link:
        x, y, z = planner.tip_position_m(start, robot.tip_link)
        near = (x, y, z + STEP_M)
        requests.append(PlanningProblem(group.name, start, PositionGoal(robot.tip_link, near, STEP_M / 4)))
        requests.append(CartesianProblem(group.name, start, robot.tip_link, (Line(Pose(near)),)))
    return requests
