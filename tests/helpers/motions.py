"""Motions of the built-in arm: trajectories made without a planner, and requests to planner processes."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from planners import problem
from planners.goals import JointGoal
from planners.scene import Pose
from robot.trajectory import Trajectory


def smooth_move(moves: Mapping[str, tuple[float, float]], duration_s: float, rate_hz: float = 100.0) -> Trajectory:
    """From rest to rest along a straight joint line, by the quintic of least jerk."""
    time_s = np.linspace(0.0, duration_s, round(duration_s * rate_hz) + 1)
    u = time_s / duration_s
    s = 10 * u**3 - 15 * u**4 + 6 * u**5
    ds = (30 * u**2 - 60 * u**3 + 30 * u**4) / duration_s
    dds = (60 * u - 180 * u**2 + 120 * u**3) / duration_s**2
    start = np.array([move[0] for move in moves.values()])
    way = np.array([move[1] - move[0] for move in moves.values()])
    return Trajectory(tuple(moves), time_s, start + np.outer(s, way), np.outer(ds, way), np.outer(dds, way))


NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
START = {**dict.fromkeys(NAMES, 0.0), "gripper": 0.0}
EASY = problem.PlanningProblem("arm", START, JointGoal({"shoulder_pan": 0.5}))
STATE = problem.StateQuestion("arm", START)
# Through the arm itself: RRT* searches for shorter paths until the time is over.
LONG = problem.PlanningProblem(
    "arm",
    {**dict(zip(NAMES, (1.0899, -1.4202, 1.3815, 1.3879, -1.704), strict=True)), "gripper": 0.0},
    JointGoal(dict(zip(NAMES, (-1.1337, -1.2821, 1.4034, 1.2004, 1.2428), strict=True))),
    allowed_time_s=60.0,
    optimization_time_s=60.0,
    planner_id="RRTstar",
)
STILL = Trajectory(NAMES, np.zeros(1), np.zeros((1, 5)), np.zeros((1, 5)), np.zeros((1, 5)))
FINGER = Trajectory(("gripper",), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
# Each kind of request, and the kind of its answer.
REQUESTS: list[tuple[problem.Request, type[problem.Answer]]] = [
    (EASY, problem.Plan),
    (
        problem.CartesianProblem("arm", START, "gripper_frame_link", (problem.Line(Pose((0.3, 0.0, 0.2))),)),
        problem.CartesianPlan,
    ),
    (problem.IkQuestion("arm", START, JointGoal({"shoulder_pan": 0.5})), problem.IkAnswer),
    (STATE, problem.StateAnswer),
    (problem.RecheckQuestion("arm", STILL, START, 0.0), problem.RecheckAnswer),
    (problem.ConcurrencyQuestion(STILL, FINGER, START), problem.RecheckAnswer),
]


def broken(fault: str, allowed_time_s: float = 10.0) -> problem.PlanningProblem:
    """A problem that the planner of :mod:`tests.helpers.broken_planner` meets with a fault."""
    return dataclasses.replace(EASY, group=fault, allowed_time_s=allowed_time_s)
