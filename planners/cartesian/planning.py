"""Planning of tip paths: they are followed as far as they go, timed, and certified as they will be executed.

TOPP-RA gives the least time within velocity and acceleration limits: Pham & Pham, "A New Approach to Time-Optimal Path
Parameterization Based on Reachability Analysis", 2018.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planners import checks
from planners.budget import Budget
from planners.cartesian.following import (
    FollowedPath,
    PathEnd,
    PathFollower,
    SplinePath,
    TipTracker,
    leaves_limits,
    tip_curve,
)
from planners.cartesian.lean_toppra import (
    TOPPRA,
    DiscretizationType,
    JointAccelerationConstraint,
    JointVelocityConstraintVarying,
)
from planners.cartesian.tip_path import TipPath, as_pose, check_path, check_shape
from planners.geometry.certificate import certify
from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.kinematics import ForwardKinematics
from planners.ik.constraints import ConditionSet, Joints, conditions
from planners.ik.goal_checks import in_words
from planners.ik.goal_refusals import start_violates
from planners.motions.motion import MAX_DURATION_S
from planners.problem import CartesianPlan, CartesianProblem, Deviation, MoveItErrorCode, PlanningFailure, RateLimits
from planners.scene import Pose
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector

# The servo loop runs at 100 Hz.
SAMPLE_PERIOD_S = 0.01

# Samples closer together than this lose digits in the interpolation between them.
SHORTEST_INTERVAL_S = 0.001

# Where the joints stand nothing else bounds the progress, which is about 1 where they move, in scaled units. Much more
# makes numbers that toppra's solver takes for 0.
FASTEST_RATE = 30.0

# Where the arm can only stand, toppra's tolerance of 1e-8 in squared rates makes it crawl at up to 7e-4 of these units.
STANDING_RATE = 1e-3

# Where the tip moves by less per length of the path it stands, and its speed limits nothing.
STANDING_SHARE = 1e-3

# Decimals of the place that is reached, which people read: a tenth of a millimetre.
DIGITS = 4

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
    refusal = check_path(robot, problem) or checks.check_start(robot, problem.start_rad)
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
    group = robot.groups[problem.group]
    space = JointSpace(collision, group, start_q, allowed, constraints.holds, should_stop=budget.should_stop)
    columns = [collision.joint_names.index(name) for name in group.joints]
    limits = collision.lower_rad, collision.upper_rad
    tracker = TipTracker(forward, limits, columns, start_q, problem.link)
    start = tracker.pose(start_q[columns])
    refusal = check_shape(start.translation, problem)
    if refusal is not None:
        return refusal
    path = TipPath(start, problem.segments)
    rates = _rate_limits(robot, problem)

    check_point = _PointCheck(space, constraints, start_q, columns, problem.avoid_collisions)
    task = _Task(problem, robot.groups[problem.group].joints, rates, tracker, path, space, check_point)
    return task.plan(start_q[columns], budget)


def _rate_limits(robot: RobotModel, problem: CartesianProblem) -> RateLimits:
    joints = [robot.joints[name] for name in robot.groups[problem.group].joints]
    return RateLimits(
        problem.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
        problem.acceleration_scaling * np.array([joint.max_acceleration for joint in joints]),
    )


@dataclass(frozen=True)
class _PointCheck:
    """Flaws of single points of the path."""

    space: JointSpace
    constraints: ConditionSet
    start_q: Vector
    columns: list[int]
    avoid_collisions: bool

    def __call__(self, point: Vector) -> PathEnd | None:
        if self.avoid_collisions:
            free = self.space.free(point) or (self.space.refine_at(point) and self.space.free(point))
            return None if free else self.ended(self.space.contacts(point), point)
        q = self._configuration(point)
        return None if self.constraints.holds(q) else self.ended((), point)

    def ended(self, pairs: Sequence[CollidingPair], point: Vector) -> PathEnd:
        """Return the flaw of a point that is not free: contacts, or else the constraints that do not hold there."""
        if pairs:
            sentence = f"there would touch: {checks.describe_pairs(pairs)}"
            return PathEnd("collision", sentence, {"pairs": checks.pairs_as_data(pairs)})
        violations = self.constraints.violations(self._configuration(point))
        sentences = [violation.sentence for violation in violations]
        return PathEnd("constraint", "; ".join(sentences), {"violations": [dict(v.details) for v in violations]})

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
    check_point: _PointCheck

    def plan(self, start: Vector, budget: Budget) -> CartesianPlan | PlanningFailure:
        """Follow the path, and shorten it until what is left is certified."""
        return self._certified(self._followed(start, budget.used_up), start, budget)

    def _certified(self, followed: FollowedPath, start: Vector, budget: Budget) -> CartesianPlan | PlanningFailure:
        while not budget.used_up() and len(followed.points) > 1:
            drawn = tip_curve(followed, self.path, self.tracker)
            motion = time_along(drawn.curve, self.joint_names, self.limits, self._top_rate(drawn.curve))
            if motion is None:
                text = f"the path bends too sharply to be timed, or takes more than {MAX_DURATION_S:g} s"
                return PlanningFailure(MoveItErrorCode.PLANNING_FAILED, text)
            end = self._end(motion)
            if end is None:
                return self._answer(drawn.followed, motion, drawn.deviation, budget)
            followed = _shortened(drawn.followed, *end)
        return budget.failure() if budget.used_up() else self._answer(followed, self._stand(start), Deviation(), budget)

    def _end(self, motion: Trajectory) -> tuple[Vector, PathEnd] | None:
        """Return the point beyond which a motion may not go, and the reason."""
        beyond = np.argwhere(self.tracker.outside(motion.positions_rad))
        if len(beyond):
            sample, joint = beyond[0]
            return motion.positions_rad[sample], leaves_limits(self.joint_names[joint])
        contact = certify(self.space, motion) if self.problem.avoid_collisions else None
        if contact is None:
            return None
        point = motion.sample(contact.time_s)[0]
        return point, self.check_point.ended(contact.pairs, point)

    def _followed(self, start: Vector, should_stop: Callable[[], bool]) -> FollowedPath:
        problem = self.problem
        tolerance_rad = problem.orientation_tolerance_rad if problem.keep_orientation else np.inf
        return PathFollower(
            self.tracker,
            self.joint_names,
            self.path,
            problem.max_step_m,
            problem.max_joint_step_rad,
            tolerance_rad,
            self.check_point,
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

    def _answer(
        self, followed: FollowedPath, motion: Trajectory, deviation: Deviation, budget: Budget
    ) -> CartesianPlan:
        done_m, length_m = float(followed.along_m[-1]), self.path.length_m
        fraction = done_m / length_m if length_m > 0.0 else 1.0
        reached = as_pose(self.path.at(done_m), DIGITS)
        stopped_by = None if followed.ended is None else _stopped_by(followed.ended, done_m, length_m, reached)
        return CartesianPlan(motion, fraction, stopped_by, budget.spent_s, deviation)


def _shortened(followed: FollowedPath, contact: Vector, ended: PathEnd) -> FollowedPath:
    """The part of a path before the point that comes nearest to a contact; the start at least."""
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


@dataclass(frozen=True)
class Profile:
    """Progress along a path: between knots the progress accelerates uniformly.

    Attributes:
        s: shape (k,), lengths [rad].
        rate: shape (k,), progress there [rad/s]; 0 at both ends.
    """

    s: Vector
    rate: Vector

    @property
    def times_s(self) -> Vector:
        """Time of each knot, shape (k,) [s]."""
        return np.concatenate(([0.0], np.cumsum(2.0 * np.diff(self.s) / (self.rate[:-1] + self.rate[1:]))))


def sampled(path: SplinePath, profile: Profile, joint_names: tuple[str, ...], points: Vector) -> Trajectory:
    """The motion along a path, sampled at its knots and at 100 Hz; it starts and ends exactly in ``points``' ends."""
    knots_s = profile.times_s
    times_s = _sample_times(knots_s)
    i = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, 0, len(knots_s) - 2)
    since_s = times_s - knots_s[i]
    acceleration = np.diff(profile.rate)[i] / np.diff(knots_s)[i]
    rate = profile.rate[i] + acceleration * since_s
    s = profile.s[i] + (profile.rate[i] + 0.5 * acceleration * since_s) * since_s
    tangent, curvature = path(s, 1), path(s, 2)
    positions = path(s)
    velocities = tangent * rate[:, np.newaxis]
    accelerations = curvature * rate[:, np.newaxis] ** 2 + tangent * acceleration[:, np.newaxis]
    positions[[0, -1]] = points[[0, -1]]
    velocities[[0, -1]] = 0.0
    # Arrived, the arm stays: the last braking belongs to the samples before.
    accelerations[-1] = 0.0
    return Trajectory(joint_names, times_s, positions, velocities, accelerations)


def _sample_times(knots_s: Vector) -> Vector:
    """Knots and a 100 Hz grid, without grid points beside knots and without knots beside each other."""
    kept = [0.0]
    for knot_s in knots_s[1:-1]:
        if knot_s - kept[-1] > SHORTEST_INTERVAL_S and knots_s[-1] - knot_s > SHORTEST_INTERVAL_S:
            kept.append(float(knot_s))
    kept.append(float(knots_s[-1]))
    knots = np.array(kept)
    grid = np.arange(SAMPLE_PERIOD_S, knots[-1], SAMPLE_PERIOD_S)
    after = np.searchsorted(knots, grid)
    apart = np.minimum(grid - knots[after - 1], knots[after] - grid) > SHORTEST_INTERVAL_S
    return np.sort(np.concatenate((knots, grid[apart])))


def within_limits(trajectory: Trajectory, limits: RateLimits) -> Trajectory:
    """The motion slowed down until its cubic interpolation keeps the limits everywhere."""
    span_s = np.diff(trajectory.time_s)[:, np.newaxis]
    slope = np.diff(trajectory.positions_rad, axis=0) / span_s
    v0, v1 = trajectory.velocities_rad_s[:-1], trajectory.velocities_rad_s[1:]
    a0, a1 = (6.0 * slope - 4.0 * v0 - 2.0 * v1) / span_s, (2.0 * v0 + 4.0 * v1 - 6.0 * slope) / span_s
    # Acceleration is a line over each interval and greatest at an end; velocity is a parabola, greatest there or
    # where the line crosses zero.
    crossing = np.clip(np.divide(a0, a0 - a1, out=np.zeros_like(a0), where=a0 != a1), 0.0, 1.0)
    turning = v0 + span_s * crossing * (a0 + 0.5 * crossing * (a1 - a0))
    velocity_excess = max(np.max(np.abs(v) / limits.velocity_rad_s) for v in (v0, v1, turning))
    acceleration_excess = max(np.max(np.abs(a) / limits.acceleration_rad_s2) for a in (a0, a1))
    stretch = max(1.0, float(velocity_excess), float(np.sqrt(acceleration_excess)))
    return Trajectory(
        trajectory.joint_names,
        trajectory.time_s * stretch,
        trajectory.positions_rad,
        trajectory.velocities_rad_s / stretch,
        trajectory.accelerations_rad_s2 / stretch**2,
    )


def toppra_profile(path: SplinePath, limits: RateLimits, top_rate: Vector | None = None) -> Profile | None:
    """The fastest progress along a path from rest to rest.

    Args:
        path: its acceleration limits are kept at the points of its ``grid`` and nearly so between them.
        limits: of the joints.
        top_rate: shape (len(path.grid),), further limits of the progress rate, each above 0.

    Returns:
        None when the path demands an infinite acceleration, or stands still from start to end, or has numbers that are
        not finite.
    """
    length = float(path.knots[-1] - path.knots[0])
    reach_s2 = np.abs(path(path.grid, 1)) * length / limits.acceleration_rad_s2
    unit_s = float(np.sqrt(np.max(reach_s2)))
    if not 0.0 < unit_s < np.inf:
        return None
    scaled = _ScaledPath(path, length, limits.acceleration_rad_s2 * unit_s**2)
    scaled_velocity = limits.velocity_rad_s * unit_s / scaled.joint_units_rad
    scaled_top = np.full(len(scaled.grid), FASTEST_RATE)
    if top_rate is not None:
        scaled_top = np.minimum(scaled_top, top_rate * unit_s / length)
    rate = _fastest(scaled, scaled_velocity, scaled_top)
    # The motion may stop in a point, but has to get away from it.
    if not np.all(rate[:-1] + rate[1:] > 2.0 * STANDING_RATE * min(1.0, scaled_top.min())):
        return None
    return Profile(path.grid, rate * length / unit_s)


@dataclass(frozen=True)
class _ScaledPath:
    """A path for toppra, with numbers of about 1, which its tolerances are made for.

    Its last column is progress itself, so that limits of the progress rate are those of a joint.

    Attributes:
        path: what is scaled.
        length: of its parameter, which goes from 0 to 1 here.
        joint_units_rad: shape (n,), what is 1 here; with them the acceleration limits are 1.
    """

    path: SplinePath
    length: float
    joint_units_rad: Vector

    @property
    def grid(self) -> Vector:
        """Parameters for timing."""
        return np.asarray((self.path.grid - self.path.knots[0]) / self.length)

    @property
    def dof(self) -> int:
        """Number of columns."""
        return len(self.joint_units_rad) + 1

    @property
    def path_interval(self) -> Vector:
        """First and last parameter."""
        return np.array([0.0, 1.0])

    def __call__(self, path_positions: Vector, order: int = 0) -> Vector:
        """As :class:`SplinePath`."""
        joints = self.path(self.path.knots[0] + self.length * path_positions, order)
        progress = (path_positions, np.ones_like(path_positions), np.zeros_like(path_positions))[order]
        return np.column_stack((joints * (self.length**order / self.joint_units_rad), progress / FASTEST_RATE**2))


def _fastest(path: _ScaledPath, velocity: Vector, top_rate: Vector) -> Vector:
    """The greatest rate at each grid point, not a number where toppra finds none.

    Args:
        path: with acceleration limits of 1.
        velocity: shape (n,), limits of the joints.
        top_rate: shape (len(path.grid),), limits of the rate.
    """
    grid = path.grid
    allowed = np.column_stack((np.tile(velocity, (len(grid), 1)), top_rate / FASTEST_RATE**2))
    both_ways = np.stack((-allowed, allowed), axis=2)
    constraints = [
        JointVelocityConstraintVarying(lambda position: both_ways[np.searchsorted(grid, position)]),
        # The scheme that looks at single points exceeds the limits up to 2.4 times between them.
        JointAccelerationConstraint(np.ones(path.dof), DiscretizationType.Interpolation),
    ]
    solver = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, rate, _ = solver.compute_parameterization(0.0, 0.0)
    return np.full_like(grid, np.nan) if rate is None else rate


def time_along(
    path: SplinePath, joint_names: tuple[str, ...], limits: RateLimits, top_rate: Vector | None = None
) -> Trajectory | None:
    """The fastest motion along a path from rest to rest, whose interpolation keeps the limits as well.

    Args:
        path: where the joints go.
        joint_names: the joints of its columns.
        limits: of the joints.
        top_rate: as for :func:`toppra_profile`.

    Returns:
        Samples at most 10 ms apart, or None where :func:`toppra_profile` has none, or one that takes too long.
    """
    profile = toppra_profile(path, limits, top_rate)
    if profile is None or profile.times_s[-1] > MAX_DURATION_S:
        return None
    return within_limits(sampled(path, profile, joint_names, path.points), limits)
