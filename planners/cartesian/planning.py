"""Paths of the tip: followed as far as they go, timed, and certified as they will be driven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners import checks
from planners.budget import Budget
from planners.cartesian import tip_path as cartesian_checks
from planners.cartesian.following import Ended, Followed, Following, TipTracker, leaves_limits
from planners.cartesian.path_timing import time_along
from planners.cartesian.tip_curve import SplinePath, tip_curve
from planners.cartesian.tip_path import TipPath
from planners.geometry.certificate import certify
from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.kinematics import ForwardKinematics
from planners.ik.constraints import ConditionSet, Joints, conditions
from planners.ik.goal_refusals import start_violates
from planners.problem import CartesianPlan, CartesianProblem, Deviation, MoveItErrorCode, PlanningFailure, RateLimits
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

Vector = NDArray[np.float64]

# Where the tip moves by less per length of the path it stands, and its speed limits nothing.
STANDING_SHARE = 1e-3

# What ends a path, as MoveIt's Pilz planner tells it.
CODES = {
    "reach": MoveItErrorCode.NO_IK_SOLUTION,
    "orientation": MoveItErrorCode.NO_IK_SOLUTION,
    "limit": MoveItErrorCode.PLANNING_FAILED,
    "jump": MoveItErrorCode.PLANNING_FAILED,
    "collision": MoveItErrorCode.INVALID_MOTION_PLAN,
    "constraint": MoveItErrorCode.INVALID_MOTION_PLAN,
}


def plan_cartesian(
    problem: CartesianProblem, robot: RobotModel, collision: CollisionModel, forward: ForwardKinematics, budget: Budget
) -> CartesianPlan | PlanningFailure:
    """Plan the motion along a path of the tip, as far as the path can be followed.

    Args:
        problem: the path.
        robot: the arm.
        collision: its collisions with itself and the scene.
        forward: its kinematics; configurations are in the order of the collisions' joints.
        budget: ends it.

    Returns:
        A plan for the whole path or its first part, which may be nothing; or a failure when the problem or the start
        is refused or time is up.
    """
    refusal = cartesian_checks.check_path(robot, problem) or checks.check_start(robot, problem.start_rad)
    if refusal is not None:
        return refusal
    start_q = np.array([problem.start_rad[name] for name in collision.joint_names])
    start_q = np.clip(start_q, collision.lower_rad, collision.upper_rad)
    joints = Joints(collision.joint_names, collision.lower_rad, collision.upper_rad)
    constraints = ConditionSet(forward, conditions(problem.path_constraints, joints))
    contacts = collision.colliding_pairs(start_q) if problem.avoid_collisions else []
    refusal = checks.check_start_contact(contacts)
    if refusal is not None:
        return refusal
    if not constraints.holds(start_q):
        return start_violates(constraints.violations(start_q))
    allowed = collision.overlaps_m(start_q) if problem.avoid_collisions else {}
    space = JointSpace(collision, robot.groups[problem.group], start_q, allowed, constraints.holds)
    columns = [collision.joint_names.index(name) for name in robot.groups[problem.group].joints]
    limits = collision.lower_rad, collision.upper_rad
    tracker = TipTracker(forward, limits, columns, start_q, problem.link)
    start = tracker.pose(start_q[columns])
    refusal = cartesian_checks.check_shape(start.translation, problem)
    if refusal is not None:
        return refusal
    flaw = _PointFlaws(space, constraints, start_q, columns, problem.avoid_collisions)
    path = TipPath(start, problem.segments)
    task = _Task(problem, robot.groups[problem.group].joints, _rate_limits(robot, problem), tracker, path, space, flaw)
    return task.plan(start_q[columns], budget)


def _rate_limits(robot: RobotModel, problem: CartesianProblem) -> RateLimits:
    joints = [robot.joints[name] for name in robot.groups[problem.group].joints]
    return RateLimits(
        problem.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
        problem.acceleration_scaling * np.array([joint.max_acceleration for joint in joints]),
    )


@dataclass(frozen=True)
class _PointFlaws:
    """Flaws of single points of the path."""

    space: JointSpace
    constraints: ConditionSet
    start_q: Vector
    columns: list[int]
    avoid_collisions: bool

    def __call__(self, point: Vector) -> Ended | None:
        if self.avoid_collisions:
            free = self.space.free(point) or (self.space.look_closer(point) and self.space.free(point))
            return None if free else self.ended(self.space.contacts(point), point)
        q = self._configuration(point)
        return None if self.constraints.holds(q) else self.ended((), point)

    def ended(self, pairs: Sequence[CollidingPair], point: Vector) -> Ended:
        """Return the flaw of a point that is not free: contacts, or else the constraints that do not hold there."""
        if pairs:
            sentence = f"there would touch: {checks.describe_pairs(pairs)}"
            return Ended("collision", sentence, {"pairs": checks.pairs_as_data(pairs)})
        violations = self.constraints.violations(self._configuration(point))
        sentences = [violation.sentence for violation in violations]
        return Ended("constraint", "; ".join(sentences), {"violations": [dict(v.details) for v in violations]})

    def _configuration(self, point: Vector) -> Vector:
        q = self.start_q.copy()
        q[self.columns] = point
        return q


@dataclass(frozen=True)
class _Task:
    """One checked problem."""

    problem: CartesianProblem
    joint_names: tuple[str, ...]
    limits: RateLimits
    tracker: TipTracker
    path: TipPath
    space: JointSpace
    flaw: _PointFlaws

    def plan(self, start: Vector, budget: Budget) -> CartesianPlan | PlanningFailure:
        """Follow the path, and shorten it until what is left is certified."""
        followed = self._followed(start, budget.used_up)
        while not budget.used_up() and len(followed.points) > 1:
            drawn = tip_curve(followed, self.path, self.tracker)
            motion = time_along(drawn.curve, self.joint_names, self.limits, self._top_rate(drawn.curve))
            if motion is None:
                return PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "the path bends too sharply to be timed")
            end = self._end(motion)
            if end is None:
                return self._answer(drawn.followed, motion, drawn.deviation, budget)
            followed = _shortened(drawn.followed, *end)
        return budget.failure() if budget.used_up() else self._answer(followed, self._stand(start), Deviation(), budget)

    def _end(self, motion: Trajectory) -> tuple[Vector, Ended] | None:
        """Return the point beyond which a motion may not go, and the reason."""
        beyond = np.argwhere(self.tracker.outside(motion.positions_rad))
        if len(beyond):
            sample, joint = beyond[0]
            return motion.positions_rad[sample], leaves_limits(self.joint_names[joint])
        contact = certify(self.space, motion) if self.problem.avoid_collisions else None
        if contact is None:
            return None
        point = motion.sample(contact.time_s)[0]
        return point, self.flaw.ended(contact.pairs, point)

    def _followed(self, start: Vector, should_stop: Callable[[], bool]) -> Followed:
        problem = self.problem
        tolerance_rad = problem.orientation_tolerance_rad if problem.keep_orientation else np.inf
        return Following(
            self.tracker,
            self.joint_names,
            self.path,
            problem.max_step_m,
            problem.max_joint_step_rad,
            tolerance_rad,
            self.flaw,
            should_stop,
        ).from_point(start)

    def _stand(self, start: Vector) -> Trajectory:
        rest = np.zeros((1, len(start)))
        return Trajectory(self.joint_names, np.zeros(1), start[np.newaxis], rest, rest)

    def _top_rate(self, curve: SplinePath) -> Vector | None:
        """Return the greatest speed along the path at each grid point for the tip to keep its limit [m/s]."""
        if self.problem.tip_speed_m_s is None:
            return None
        moves = zip(curve(curve.grid), curve(curve.grid, 1), strict=True)
        shares = np.array([self.tracker.speed_m(point, tangent) for point, tangent in moves])
        return np.asarray(self.problem.tip_speed_m_s / np.maximum(shares, STANDING_SHARE))

    def _answer(self, followed: Followed, motion: Trajectory, deviation: Deviation, budget: Budget) -> CartesianPlan:
        done_m, length_m = float(followed.along_m[-1]), self.path.length_m
        fraction = done_m / length_m if length_m > 0.0 else 1.0
        stopped_by = None if followed.ended is None else _stopped_by(followed.ended, done_m, length_m)
        return CartesianPlan(motion, fraction, stopped_by, budget.spent_s, deviation)


def _shortened(followed: Followed, contact: Vector, ended: Ended) -> Followed:
    """The part of a path before the point that comes nearest to a contact; the start at least."""
    nearest = int(np.argmin(np.max(np.abs(followed.points - contact), axis=1)))
    kept = max(1, min(nearest, len(followed.points) - 1))
    return Followed(followed.along_m[:kept], followed.points[:kept], ended)


def _stopped_by(ended: Ended, along_m: float, length_m: float) -> PlanningFailure:
    return PlanningFailure(
        CODES[ended.reason],
        f"the path can be followed for {100.0 * along_m:.1f} of {100.0 * length_m:.1f} cm: {ended.sentence}",
        {"reason": ended.reason, "along_m": along_m, "length_m": length_m, **ended.details},
    )
