"""A planner, and what its plans are judged by."""

import numpy as np

from planners.geometry.kinematics import ForwardKinematics
from planners.problem import Plan, PlanningProblem, RateLimits
from tests.planners import invariants

TIP = "gripper_frame_link"


class Setting:
    """A planner with what its plans are judged by."""

    def __init__(self, planner, robot, collision, tip=TIP):
        self.planner, self.robot, self.collision, self.tip = planner, robot, collision, tip
        self.forward = ForwardKinematics(robot, collision.joint_names)
        self.joints = robot.groups["arm"].joints

    def start(self, positions_rad, gripper_rad=0.3):
        return {"gripper": gripper_rad} | dict(zip(self.joints, map(float, positions_rad), strict=True))

    def home(self, **changes):
        return self.start([0.0] * 5, 0.0) | changes

    def problem(self, goal, start_rad=None, **options):
        return PlanningProblem("arm", start_rad or self.home(), goal, **options)

    def solve(self, problem):
        """Plan, and judge the plan by every invariant that holds for all goals."""
        plan = self.planner.plan(problem)
        assert isinstance(plan, Plan), plan
        motion = plan.trajectory
        start = [problem.start_rad[name] for name in self.joints]
        limits = [self.robot.joints[name] for name in self.joints]
        assert motion.joint_names == self.joints
        invariants.assert_well_formed(motion)
        invariants.assert_from_rest_to_rest(motion, start, motion.positions_rad[-1])
        invariants.assert_keeps_positions(motion, [each.lower for each in limits], [each.upper for each in limits])
        invariants.assert_keeps_rates(motion, self.scaled_limits(problem))
        invariants.assert_touches_nothing(motion, self.collision, problem.start_rad)
        return plan

    def scaled_limits(self, problem):
        joints = [self.robot.joints[name] for name in self.joints]
        return RateLimits(
            problem.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
            problem.acceleration_scaling * np.array([joint.max_acceleration for joint in joints]),
        )

    def random_state(self, rng):
        while True:
            q = rng.uniform(self.collision.lower_rad, self.collision.upper_rad)
            if not self.collision.in_collision(q):
                return dict(zip(self.collision.joint_names, q.tolist(), strict=True))

    def tip_m(self, positions_rad):
        q = np.array([positions_rad[name] for name in self.collision.joint_names])
        return tuple(self.forward.placements([q], TIP).positions_m[0].tolist())


def end_of(plan):
    return dict(zip(plan.trajectory.joint_names, plan.trajectory.positions_rad[-1], strict=True))
