"""Planning of tip paths: they are followed as far as they go, timed, and certified as they will be executed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners import checks
from planners.budget import Budget
from planners.cartesian.following import FollowedPath, PathEnd, PathFollower, TipTracker, leaves_limits, tip_curve
from planners.cartesian.tip_path import TipPath, check_path, check_shape, rounded_pose
from planners.geometry.certificate import certify
from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.kinematics import ForwardKinematics
from planners.ik.constraints import ConditionSet, Joints, conditions
from planners.ik.goal_checks import in_words
from planners.ik.goal_refusals import check_start_place
from planners.motions.path_timing import MAX_DURATION_S, standing, time_along
from planners.motions.spline import NaturalSpline
from planners.problem import CartesianPlan, CartesianProblem, Deviation, MoveItErrorCode, PlanningFailure, RateLimits
from planners.scene import Pose
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector

# Where the tip moves by less per length of the path it stands, and its speed limits nothing.
STANDING_SHARE = 1e-3

# Decimals of the place that is reached, which people read: a tenth of a millimetre.
DIGITS = 4

# Codes for the ends of a path, as of MoveIt's Pilz planner.
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

    The plan is for the whole path or its first part, which may be nothing. It is a failure where the problem or the
    start is refused or time is up. ``forward`` has the joints in the order of ``collision``.
    """
    refusal = check_path(robot, problem) or checks.check_start(robot, problem.start_rad)
    if refusal is not None:
        return refusal
    names = robot.groups[problem.group].joints
    start_q = collision.start(problem.start_rad, names)
    joints = Joints(collision.joint_names, collision.lower_rad, collision.upper_rad)
    constraints = ConditionSet(forward, conditions(problem.path_constraints, joints))
    contacts = collision.colliding_pairs(start_q) if problem.avoid_collisions else []
    refusal = check_start_place(contacts, constraints.violations(start_q))
    if refusal is not None:
        return refusal
    allowed = collision.overlaps_m(start_q) if problem.avoid_collisions else {}
    space = JointSpace(collision, names, start_q, allowed, constraints.holds, should_stop=budget.should_stop)
    tracker = TipTracker(forward, collision, names, start_q, problem.link)
    start = tracker.pose(space.point(start_q))
    refusal = check_shape(start.translation, problem)
    if refusal is not None:
        return refusal
    limits = RateLimits.of(
        [robot.joints[name] for name in names], problem.velocity_scaling, problem.acceleration_scaling
    )
    task = _Task(problem, limits, tracker, TipPath(start, problem.segments), space, constraints)
    return task.plan(space.point(start_q), budget)


@dataclass(frozen=True)
class _Task:
    """One checked problem."""

    problem: CartesianProblem
    limits: RateLimits
    tracker: TipTracker
    path: TipPath
    space: JointSpace
    constraints: ConditionSet

    def plan(self, start: Vector, budget: Budget) -> CartesianPlan | PlanningFailure:
        """Follow the path, and shorten it until it is certified."""
        followed = PathFollower(self.problem, self.tracker, self.path, self._flaw, budget.used_up).from_point(start)
        names = self.tracker.joint_names
        while not budget.used_up() and len(followed.points) > 1:
            drawn = tip_curve(followed, self.path, self.tracker)
            motion = time_along(drawn.curve, names, self.limits, self._top_rate(drawn.curve))
            if motion is None:
                text = f"the path bends too sharply to be timed, or takes more than {MAX_DURATION_S:g} s"
                return PlanningFailure(MoveItErrorCode.PLANNING_FAILED, text)
            end = self._end(motion)
            if end is None:
                return self._answer(drawn.followed, motion, drawn.deviation, budget)
            followed = _shortened(drawn.followed, *end)
        if budget.used_up():
            return budget.failure()
        return self._answer(followed, standing(names, start), Deviation(), budget)

    def _flaw(self, point: Vector) -> PathEnd | None:
        """Return the reason for which the path ends at a point, None to go on."""
        if self.problem.avoid_collisions:
            return None if self.space.free_by_parts(point) else self._ended(self.space.contacts(point), point)
        return None if self.constraints.holds(self.space.configuration(point)) else self._ended((), point)

    def _ended(self, pairs: Sequence[CollidingPair], point: Vector) -> PathEnd:
        if pairs:
            sentence = f"there would touch: {checks.describe_pairs(pairs)}"
            return PathEnd("collision", sentence, {"pairs": checks.pairs_as_data(pairs)})
        violations = self.constraints.violations(self.space.configuration(point))
        sentences = [violation.sentence for violation in violations]
        return PathEnd("constraint", "; ".join(sentences), {"violations": [dict(v.details) for v in violations]})

    def _end(self, motion: Trajectory) -> tuple[Vector, PathEnd] | None:
        """Return the point beyond which a motion may not go, and the reason."""
        beyond = np.argwhere(self.tracker.outside(motion.positions_rad))
        if len(beyond):
            sample, joint = beyond[0]
            return motion.positions_rad[sample], leaves_limits(self.tracker.joint_names[joint])
        contact = certify(self.space, motion) if self.problem.avoid_collisions else None
        if contact is None:
            return None
        point = motion.sample(contact.time_s)[0]
        return point, self._ended(contact.pairs, point)

    def _top_rate(self, curve: NaturalSpline) -> Vector | None:
        """Return the greatest speed along the path at each grid point for the tip to keep its limit [m/s]."""
        if self.problem.tip_speed_m_s is None:
            return None
        moves = zip(curve(curve.grid), curve(curve.grid, 1), strict=True)
        shares = np.array([self.tracker.speed_m(point, tangent) for point, tangent in moves])
        return np.asarray(self.problem.tip_speed_m_s / np.maximum(shares, STANDING_SHARE))

    def _answer(
        self, followed: FollowedPath, motion: Trajectory, deviation: Deviation, budget: Budget
    ) -> CartesianPlan:
        done_m, length_m = float(followed.along_m[-1]), self.path.length_m
        fraction = done_m / length_m if length_m > 0.0 else 1.0
        reached = rounded_pose(self.path.at(done_m), DIGITS)
        stopped_by = None if followed.ended is None else _stopped_by(followed.ended, done_m, length_m, reached)
        return CartesianPlan(motion, fraction, stopped_by, budget.spent_s, deviation)


def _shortened(followed: FollowedPath, contact: Vector, ended: PathEnd) -> FollowedPath:
    """Return the part of a path before the point that comes nearest to a contact; the start at least."""
    nearest = int(np.argmin(np.max(np.abs(followed.points - contact), axis=1)))
    kept = max(1, min(nearest, len(followed.points) - 1))
    return FollowedPath(followed.along_m[:kept], followed.points[:kept], ended)


def _stopped_by(ended: PathEnd, along_m: float, length_m: float, reached: Pose) -> PlanningFailure:
    to = f", to {in_words(reached.position_m)} m" if along_m > 0.0 else ""
    return PlanningFailure(
        CODES[ended.reason],
        f"the path can be followed for {100.0 * along_m:.1f} of {100.0 * length_m:.1f} cm{to}: {ended.sentence}",
        {
            "reason": ended.reason,
            "along_m": along_m,
            "length_m": length_m,
            "reached_fraction": along_m / length_m if length_m > 0.0 else 0.0,
            "reached_m": list(reached.position_m),
            "reached_orientation": list(reached.orientation),
            **ended.details,
        },
    )
