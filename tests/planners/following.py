"""Paths of the tip for the SO-101, from anywhere to nearby."""

import numpy as np
from hypothesis import strategies as st

from planners.budget import Budget
from planners.cartesian.planning import TipTracker, plan_cartesian
from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import as_pose
from planners.problem import Arc, CartesianProblem, Line, PlanningError
from tests.planners.invariants import never

TIP = "gripper_frame_link"
ARM = [0, 1, 2, 3, 4]

shares = st.tuples(*[st.floats(-1.0, 1.0).map(lambda value: round(value, 2))] * 5).map(np.array)


class Follower:
    """Plans paths of the SO-101's tip, and tells where the tip is."""

    def __init__(self, robot, collision):
        self.robot, self.collision = robot, collision
        self.forward = ForwardKinematics(robot, collision.joint_names)
        self.lower_rad, self.upper_rad = collision.lower_rad[ARM], collision.upper_rad[ARM]

    def tracker(self, point):
        names = self.robot.groups["arm"].joints
        return TipTracker(self.forward, self.collision, names, np.array([*point, 0.0]), TIP)

    def pose(self, point):
        return self.tracker(point).pose(point)

    def point(self, share):
        """Shares -1 to 1 of the joints' ranges as positions."""
        return 0.5 * (self.lower_rad + self.upper_rad) + 0.45 * share * (self.upper_rad - self.lower_rad)

    def near(self, point, share):
        """A point up to 0.4 rad away in each joint, within the limits."""
        return np.clip(point + 0.4 * share, self.lower_rad, self.upper_rad)

    def problem(self, start, *segments, **asked):
        names = self.collision.joint_names
        start_rad = dict(zip(names, [*map(float, start), 0.0], strict=True))
        return CartesianProblem("arm", start_rad, TIP, segments, **asked)

    def plan(self, problem, should_stop=never):
        budget = Budget(lambda: 0.0, problem.allowed_time_s, should_stop)
        try:
            return plan_cartesian(problem, self.robot, self.collision, self.forward, budget)
        except PlanningError as error:
            return error.failure


def line(placement):
    return Line(as_pose(placement))


def arc(start, end, bulge_m):
    """An arc that leaves the line between two poses by ``bulge_m`` to a side."""
    middle, along = 0.5 * (start.translation + end.translation), end.translation - start.translation
    across = np.cross(along, [0.3, 0.5, 0.8])
    via = middle + bulge_m * across / max(np.linalg.norm(across), 1e-9)
    return Arc(tuple(map(float, via)), as_pose(end))
