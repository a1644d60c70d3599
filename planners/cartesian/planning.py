"""Planning of tip paths: they are followed as far as they go, timed, and certified as they will be executed.

Each step of following solves the position exactly and uses the remaining freedom for the orientation, after Siciliano &
Slotine, "A general framework for managing multiple tasks in highly redundant robotic systems", 1991. placo weighs both
against each other instead: an arm of five joints would leave the path for the sake of an orientation it cannot have.

The points of a followed path become a smooth curve, a natural cubic spline, on which the tip's deviation between points
is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners import checks
from planners.budget import Budget
from planners.cartesian.tip_path import TipPath, apart_m, apart_rad, check_path, check_shape, rounded_pose
from planners.checks import in_words
from planners.geometry.certificate import certify
from planners.geometry.collision import CollidingPair, CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.geometry.kinematics import ForwardKinematics
from planners.ik.constraints import ConditionSet, conditions, norm
from planners.ik.differential import Task, free_directions, solve
from planners.ik.goal_states import check_start_place
from planners.motions.path_timing import MAX_DURATION_S, standing, time_along
from planners.motions.spline import NaturalSpline
from planners.problem import CartesianPlan, CartesianProblem, Deviation, MoveItErrorCode, PlanningFailure, RateLimits
from planners.scene import Pose
from robot.description.model import RobotModel
from robot.trajectory import Trajectory, Vector

ACCURACY_M = 1e-6  # nearer is below what any servo resolves
SETTLED_RAD = 3e-4  # a step that moves no joint by more ends the orientation's descent
MAX_STEPS = 25  # neighbouring poses take two or three steps; only where a pose is out of reach are there many

# Damping of the position's least squares: singular values of an arm's Jacobian are around 0.1 m/rad and this only
# matters where one vanishes.
POSITION_DAMPING_M = 1e-4

# Damping of the orientation's least squares where it can be met; where it cannot, the damping's square is the error,
# which makes the descent to the nearest one converge (Sugihara, "Solvability-unconcerned inverse
# kinematics by the Levenberg-Marquardt method", 2011).
ORIENTATION_DAMPING = 0.02

# Joints are slowed down this near to a limit, so that they do not meet it with a jolt (Chan & Dubey, "A weighted
# least-norm solution based scheme for avoiding joint limits", 1995).
NEAR_LIMIT_RAD = 0.2

LIMIT_MARGIN_RAD = 1e-3  # the curve through the points may pass a limit by a little where a joint stops
LONGEST_STEP_RAD = 0.2  # linear prediction is poor further away
ON_PATH_M = 2e-5  # the tip counts as on the path when this near: a tenth of what the servos resolve at arm's length

# Half-way between two points a straight joint line may lead the tip this far off: the curve through all points is
# then far nearer.
CHORD_M = 2e-4

CORNER_STEP_M = 0.001  # a smooth curve rounds a corner within about a tenth of the steps beside it
GROWTH = 0.5  # steps grow with the distance from a corner by this share of it
SHORTEST_STEP_M = 0.0003  # the place where a path ends early is located this closely
LAST_STEP = 1.5  # the rest of a path is one step where it is no longer than this number of steps

# For the orientation's sake joints turn no faster than this per length of the path; a wrist that would have to flip
# does so over some centimetres. What the path itself turns comes on top, as long as no singularity is near.
TURN_RAD_PER_M = 10.0

# Below this share of turning of the tip by turning of the joints a singularity is near: a wrist about to flip has the
# share 0. UR5 turns in place by 2 rad with a share of 0.4 and more.
NEAR_SINGULARITY = 0.1


class TipTracker:
    """Follows a pose with some joints, whose positions are points, shape (n,) [rad]; others stay at ``start_q``."""

    def __init__(
        self,
        kinematics: ForwardKinematics,
        collision: CollisionModel,
        joint_names: tuple[str, ...],
        start_q: Vector,
        link: str,
    ) -> None:
        self.joint_names = joint_names
        self._kinematics = kinematics
        self._columns = np.array([collision.joint_names.index(name) for name in joint_names])
        self._link = link
        self._q = start_q.copy()
        self._limits = collision.lower_rad[self._columns], collision.upper_rad[self._columns]
        self._lower_rad = self._limits[0] + LIMIT_MARGIN_RAD
        self._upper_rad = self._limits[1] - LIMIT_MARGIN_RAD

    def pose(self, point: Vector) -> pin.SE3:
        """Return the pose of the tip in the root link's frame."""
        self._q[self._columns] = point
        self._kinematics.place(self._q)
        return self._kinematics.placement(self._link).copy()

    def outside(self, points: Vector) -> NDArray[np.bool_]:
        """Mark the joints of each point that are beyond their limits, shape (m, n)."""
        return np.asarray((points < self._limits[0]) | (points > self._limits[1]))

    def speed_m(self, point: Vector, tangent: Vector) -> float:
        """Return the tip's speed per unit motion of the joints along ``tangent``."""
        return float(np.linalg.norm(self._jacobian(point)[:3] @ tangent))

    def follow(self, point: Vector, target: pin.SE3, most_turn_rad: float, before: pin.SE3 | None = None) -> Vector:
        """Return the point nearby with the tip in the target's position, and its orientation as near as possible.

        A target out of reach leaves the tip at the nearest place that a descent from here finds. No joint moves further
        than ``most_turn_rad`` for the orientation's sake, and than the path demands from its pose ``before`` on.
        """
        point = point.copy()
        for _ in range(MAX_STEPS):
            error_m, error_rad, jacobian = self._errors(point, target)
            step, turn = self._step(point, error_m, error_rad, jacobian)
            if before is not None and float(np.max(np.abs(turn))) > most_turn_rad:
                most_turn_rad += _demanded_rad(jacobian, before, target)
                before = None
            turn *= min(1.0, most_turn_rad / max(float(np.max(np.abs(turn))), 1e-12))
            most_turn_rad -= float(np.max(np.abs(turn)))
            step += turn
            step *= min(1.0, LONGEST_STEP_RAD / max(float(np.max(np.abs(step))), LONGEST_STEP_RAD))
            settled = float(np.max(np.abs(step))) < SETTLED_RAD
            if settled and norm(error_m) < ACCURACY_M:
                break
            point = np.clip(point + step, self._lower_rad, self._upper_rad)
            if settled:
                break
        return point

    def _errors(self, point: Vector, target: pin.SE3) -> tuple[Vector, Vector, Vector]:
        """Return the errors of position and orientation, along the root link's axes, and the tip's Jacobian."""
        jacobian = self._jacobian(point)
        placement = self._kinematics.placement(self._link)
        turn = pin.log3(placement.rotation.T @ target.rotation)
        return target.translation - placement.translation, placement.rotation @ turn, jacobian

    def _jacobian(self, point: Vector) -> Vector:
        self._q[self._columns] = point
        return np.asarray(self._kinematics.jacobian(self._q, self._link)[:, self._columns])

    def _step(self, point: Vector, error_m: Vector, error_rad: Vector, jacobian: Vector) -> tuple[Vector, Vector]:
        """Return the steps for position and orientation; joints near their limits take part only where they must."""
        weight = np.ones_like(point)
        for _ in range(len(point)):
            scaled = weight * jacobian
            step, _ = solve([Task(scaled[:3], error_m)], POSITION_DAMPING_M)
            damping = math.sqrt(ORIENTATION_DAMPING**2 + norm(error_rad - scaled[3:] @ step))
            free = free_directions(scaled[:3], POSITION_DAMPING_M)
            turned, _ = solve([Task(scaled[3:], error_rad)], damping, before=step, free=free)
            step, turn = weight * step, weight * (turned - step)
            room = np.where(step + turn < 0.0, point - self._lower_rad, self._upper_rad - point)
            allowed = np.sqrt(np.clip(room / NEAR_LIMIT_RAD, 0.0, 1.0))
            if np.all(allowed >= weight):
                break
            weight = np.minimum(weight, allowed)
        return step, turn


def _demanded_rad(jacobian: Vector, before: pin.SE3, target: pin.SE3) -> float:
    """Return how far the joints turn at most to meet the change of orientation between two poses of a path [rad].

    Orientation changes along the path, and where the tip moves. The joints turn further by the inverse of
    the Jacobian's smallest singular value, among joint motions that leave the tip in its place. It is 0 near a
    singularity (Chiaverini, "Singularity-robust task-priority redundancy resolution", 1997).
    """
    free = free_directions(jacobian[:3], POSITION_DAMPING_M)
    # n joints have n - 3 directions left for turning.
    shares = np.linalg.svd(jacobian[3:] @ free, compute_uv=False)[: jacobian.shape[1] - 3]
    if not len(shares) or shares[-1] < NEAR_SINGULARITY:
        return 0.0
    moved, _ = solve([Task(jacobian[:3], target.translation - before.translation)], POSITION_DAMPING_M)
    return float((apart_rad(before, target) + norm(jacobian[3:] @ moved)) / shares[-1])


@dataclass(frozen=True)
class PathEnd:
    """Reason for which a path cannot be followed further."""

    reason: str  # "reach", "orientation", "jump", "limit", or a reason of ``PathFollower.check_point``
    sentence: str  # the reason with its figures
    details: dict[str, object]  # the figures as plain values


@dataclass(frozen=True)
class FollowedPath:
    """The part of a path that could be followed."""

    along_m: Vector  # shape (m,), lengths of the path from 0 [m]
    points: Vector  # shape (m, n), the joints there [rad]
    ended: PathEnd | None  # reason for which it is not the whole; None for all of it


@dataclass(frozen=True)
class PathFollower:
    """Conditions under which a path is followed."""

    problem: CartesianProblem  # bounds of the steps and of the orientation
    tracker: TipTracker  # the tip and its joints
    path: TipPath  # path of the tip
    check_point: Callable[[Vector], PathEnd | None]  # returns the reason to end at a point, None to go on
    should_stop: Callable[[], bool]  # returns true to end it early

    def from_point(self, start: Vector) -> FollowedPath:
        """Follow the path from its start as far as it goes, or until it is to stop."""
        along_m, points = [0.0], [start]
        step_m, ended = CORNER_STEP_M, None
        while along_m[-1] < self.path.length_m and not self.should_stop():
            reach_m = self._reach_m(along_m[-1], step_m)
            before, target = self.path.at(along_m[-1]), self.path.at(reach_m)
            most_turn_rad = TURN_RAD_PER_M * (reach_m - along_m[-1])
            point = self.tracker.follow(points[-1], target, most_turn_rad, before)
            ended = self._ended(points[-1], along_m[-1], point, reach_m)
            if ended is None:
                step_m = 2.0 * (reach_m - along_m[-1])
                along_m.append(reach_m)
                points.append(point)
            # A step to the path's end may be half as long again as the shortest, and is never cut in two.
            elif reach_m - along_m[-1] <= LAST_STEP * SHORTEST_STEP_M:
                break
            else:
                step_m = 0.5 * (reach_m - along_m[-1])
        return FollowedPath(np.array(along_m), np.array(points), ended)

    def _reach_m(self, from_m: float, step_m: float) -> float:
        """Choose the next point's distance along the path: short steps beside corners, and one exactly in each."""
        corners_m = np.array([0.0, *self.path.corners_m])
        next_m = float(corners_m[np.searchsorted(corners_m, from_m, side="right")])
        left_m = next_m - from_m
        # The end is no corner to be rounded.
        room_m = left_m if next_m == self.path.length_m else max(CORNER_STEP_M, GROWTH * left_m)
        step_m = max(min(step_m, self.problem.max_step_m, room_m), min(SHORTEST_STEP_M, self.problem.max_step_m))
        whole = left_m < LAST_STEP * step_m and left_m <= self.problem.max_step_m
        return next_m if whole else from_m + min(step_m, 0.5 * left_m)  # a rest that is much shorter bends the curve

    def _ended(self, before: Vector, from_m: float, point: Vector, reach_m: float) -> PathEnd | None:
        desired, pose = self.path.at(reach_m), self.tracker.pose(point)
        turned_rad = apart_rad(desired, pose)
        if apart_m(desired, pose) > ON_PATH_M:
            end = self.path.at(self.path.length_m)
            nearest = self.tracker.pose(self.tracker.follow(point, end, 0.0))
            return _out_of_reach(desired, apart_m(end, nearest))
        if self.problem.keep_orientation and turned_rad > self.problem.orientation_tolerance_rad:
            return _turned_away(turned_rad, self.problem.orientation_tolerance_rad)
        step = np.abs(point - before)
        most = int(np.argmax(step))
        halfway = self.tracker.pose(0.5 * (before + point)), self.path.at(0.5 * (from_m + reach_m))
        if 0.0 < self.problem.max_joint_step_rad < step[most] or apart_m(*halfway) > CHORD_M:
            return _jump(self.tracker.joint_names[most], float(step[most]), reach_m - from_m)
        return self.check_point(point)


def _out_of_reach(desired: pin.SE3, end_m: float) -> PathEnd:
    place = ", ".join(f"{value:.4g}" for value in desired.translation)
    whole = f"the tip comes no nearer to the end of the path than {100.0 * end_m:.1f} cm"
    sentence = whole if end_m > ON_PATH_M else f"the path leaves the arm's reach at ({place}) m, but not its end"
    return PathEnd("reach", sentence, {"position_m": desired.translation.tolist(), "distance_m": end_m})


def _turned_away(turned_rad: float, tolerance_rad: float) -> PathEnd:
    sentence = f"the tip would have to turn by {np.degrees(turned_rad):.1f} degrees from the orientation asked for,"
    sentence += f" where {np.degrees(tolerance_rad):.1f} are tolerated"
    return PathEnd("orientation", sentence, {"deviation_rad": turned_rad, "tolerance_rad": tolerance_rad})


def _jump(joint: str, step_rad: float, step_m: float) -> PathEnd:
    sentence = f"joint {joint!r} would jump by {step_rad:.3g} rad within {1000.0 * step_m:.2g} mm of the path"
    return PathEnd("jump", sentence, {"joint": joint, "step_rad": step_rad, "step_m": step_m})


# Places in each span between two points at which the tip is measured: half-way, where a curve is furthest off.
MEASURED_PER_SPAN = 2

LIMIT_CHECKS_PER_SPAN = 16  # places in each span at which joint limits are checked: a shorter excursion is negligible
MEASURED_AROUND = 2  # measured places by which the curve runs ahead of the path or behind it beside a corner, at most
REFINEMENTS = 5  # each round of new points halves the spans where the curve is off, and its deviation by more than that


def tip_curve(
    followed: FollowedPath, path: TipPath, tracker: TipTracker
) -> tuple[FollowedPath, NaturalSpline, Deviation]:
    """Return followed points, more where a curve left path or limits, the curve, and the tip's deviation on it."""
    for _ in range(REFINEMENTS):
        curve, off_m, turned_rad = _measured(followed, path, tracker)
        off = np.flatnonzero(off_m.reshape(-1, MEASURED_PER_SPAN).max(axis=1) > CHORD_M)
        places = curve(_along_m(followed, LIMIT_CHECKS_PER_SPAN))
        outside = np.flatnonzero(tracker.outside(places).any(axis=1).reshape(-1, LIMIT_CHECKS_PER_SPAN).any(axis=1))
        spans = np.union1d(off, outside)
        if not len(spans):
            break
        followed = _halved(followed, spans, path, tracker)
    else:
        curve, off_m, turned_rad = _measured(followed, path, tracker)
    return followed, curve, Deviation(float(off_m.max()), turned_rad)


def _measured(followed: FollowedPath, path: TipPath, tracker: TipTracker) -> tuple[NaturalSpline, Vector, float]:
    """Return the curve, the tip's distances from the path on it, shape (m,) [m], and its greatest angle [rad]."""
    curve = NaturalSpline(followed.along_m, followed.points)
    along_m = _along_m(followed, MEASURED_PER_SPAN)
    desired = [path.at(length_m) for length_m in along_m]
    poses = [tracker.pose(point) for point in curve(along_m)]
    turned_rad = max(apart_rad(*pair) for pair in zip(desired, poses, strict=True))
    places_m, line_m = (np.array([pose.translation for pose in part]) for part in (poses, desired))
    return curve, _distances_m(places_m, line_m), turned_rad


def _along_m(followed: FollowedPath, per_span: int) -> Vector:
    """Return lengths evenly within each span, its end included, shape (spans * per_span,) [m]."""
    spans = len(followed.points) - 1
    at = (np.arange(per_span * spans) + 1.0) / per_span
    return np.interp(at, np.arange(spans + 1), followed.along_m)


def _distances_m(places_m: Vector, line_m: Vector) -> Vector:
    """Return distances of places, shape (m, 3), from the pieces of a polyline around the point of the same index."""
    nearest_m = np.linalg.norm(places_m - line_m, axis=1)
    last = len(line_m) - 1
    for shift in range(-MEASURED_AROUND, MEASURED_AROUND):
        i = np.clip(np.arange(last + 1) + shift, 0, last - 1)
        edge = line_m[i + 1] - line_m[i]
        square = np.maximum(np.sum(edge**2, axis=1), np.finfo(float).tiny)
        share = np.clip(np.sum((places_m - line_m[i]) * edge, axis=1) / square, 0.0, 1.0)
        away_m = np.linalg.norm(places_m - line_m[i] - share[:, np.newaxis] * edge, axis=1)
        nearest_m = np.minimum(nearest_m, away_m)
    return np.asarray(nearest_m)


def _halved(followed: FollowedPath, spans: NDArray[np.int64], path: TipPath, tracker: TipTracker) -> FollowedPath:
    """Add a point in the middle of some spans: half-way between their ends, brought back to the path."""
    middle_m = 0.5 * (followed.along_m[spans] + followed.along_m[spans + 1])
    guesses = zip(middle_m, 0.5 * (followed.points[spans] + followed.points[spans + 1]), strict=True)
    points = np.array([tracker.follow(guess, path.at(length_m), 0.0) for length_m, guess in guesses])
    along_m = np.insert(followed.along_m, spans + 1, middle_m)
    return FollowedPath(along_m, np.insert(followed.points, spans + 1, points, axis=0), followed.ended)


STANDING_SHARE = 1e-3  # where the tip moves by less per length of the path it stands, and its speed limits nothing
DIGITS = 4  # decimals of the place that is reached, which people read: a tenth of a millimetre

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

    The plan is for the whole path or its first part, which may be nothing. It is a failure where time is up;
    PlanningError: the problem or the start is refused. ``forward`` has the joints in the order of ``collision``.
    """
    check_path(robot, problem)
    checks.check_start(robot, problem.start_rad)
    names = robot.groups[problem.group].joints
    start_q = collision.start(problem.start_rad, names)
    constraints = ConditionSet(forward, conditions(problem.path_constraints, collision))
    contacts = collision.colliding_pairs(start_q) if problem.avoid_collisions else []
    check_start_place(contacts, constraints.violations(start_q))
    allowed = collision.overlaps_m(start_q) if problem.avoid_collisions else {}
    space = JointSpace(collision, names, start_q, allowed, constraints.holds, should_stop=budget.should_stop)
    tracker = TipTracker(forward, collision, names, start_q, problem.link)
    start = tracker.pose(space.point(start_q))
    check_shape(start.translation, problem)
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
            followed, curve, deviation = tip_curve(followed, self.path, self.tracker)
            motion = time_along(curve, names, self.limits, self._top_rate(curve))
            if motion is None:
                text = f"the path bends too sharply to be timed, or takes more than {MAX_DURATION_S:g} s"
                return PlanningFailure(MoveItErrorCode.PLANNING_FAILED, text)
            end = self._end(motion)
            if end is None:
                return self._answer(followed, motion, deviation, budget)
            followed = _shortened(followed, *end)
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
            name = self.tracker.joint_names[joint]
            leaving = PathEnd("limit", f"joint {name!r} would leave its limits", {"joint": name})
            return motion.positions_rad[sample], leaving
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
