"""Servoing: from a commanded twist or joint velocity to joint velocities, many times a second.

First the joint velocities are found that give the tip its linear velocity within all limits; then, among those that
keep it, the velocities that turn the tip best. The outcome is reported as moveit_msgs/ServoStatus, and in words.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.checks import check_group, check_length, check_link, check_start, invalid_goal
from planners.geometry.broadphase import NearPair
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import as_point, as_pose, placement
from planners.ik.differential import ROUNDING, Limit, Task, barrier, solve, velocity_limit
from planners.problem import MoveItErrorCode, PlanningError, PlanningFailure
from planners.servo.question import (
    ACCELERATION_SHARE,
    APPROACH_PER_S,
    MAX_PERIOD_S,
    Anchor,
    JointVelocities,
    ServoAnswer,
    ServoLimits,
    ServoQuestion,
    ServoStatus,
    TipTarget,
    TipTwist,
)
from robot.description.model import RobotModel
from robot.trajectory import Vector

# Room for the curvature of the way: a pair's direction holds for the present configuration only. Under random sticks an
# SO-101 came up to 2 mm nearer to a table than without it [m].
CURVATURE_M = 0.003

# Share of the joints' braking that is counted on: several inequalities may need it, and directions change on the way.
BRAKING_SHARE = 0.5

EXCESS_COST = 30.0  # cost of exceeding an inequality, in changes of the joints' velocities

# Share of the way to another arm that this arm may use to brake, as the other arm may come as far: Wang, Ames and
# Egerstedt, "Safety barrier certificates for collisions-free multirobot systems", 2017. With the whole way, two
# followers at a latency of 0.095 s came into contact (test_latency.py, seed 18).
ROOM_SHARE = 0.5

# Speed of the retreat from another arm that is too near, by the room that is missing [1/s]: two arms that only stop
# creep towards each other under leaders that push them together. In 40 s they came into contact at 0.095 s.
RETREAT_PER_S = 6.0

# A command that leads towards another arm is slowed over this range of distances, down to a share at its lower end:
# at a latency of 0.095 s two arms swung by 0.07 rad beside each other, and came 3 mm nearer than with it [m].
SLOWED_M = (0.006, 0.036)
LEAST_SHARE = 0.15

# Pairs further apart than this are watched by an arm that is fast only: they limit no speed below 0.3 m/s.
WATCHED_M = 0.12


@dataclass(frozen=True)
class VelocityBounds(Limit):
    """Barriers of both limits of each joint, and then of pairs near each other.

    At rest all of them hold, except where another arm is so near that this arm retreats from it.
    """

    pairs: Sequence[NearPair]  # pairs of the last rows

    def near(self, active: NDArray[np.intp]) -> list[NearPair]:
        """Return the pairs of some inequalities."""
        first = len(self.bounds) - len(self.pairs)
        return [self.pairs[index - first] for index in active if index >= first]

    def share_towards_arms(self, velocity_rad_s: Vector) -> float:
        """Return the share of a velocity that the nearest other arm ahead leaves, shape (n,) [rad/s]."""
        ahead = self.rows[len(self.bounds) - len(self.pairs) :] @ velocity_rad_s > 0.0
        near = (pair for pair, nearer in zip(self.pairs, ahead, strict=True) if pair.by_another_arm and nearer)
        return float(np.interp(min((pair.distance_m for pair in near), default=np.inf), SLOWED_M, (LEAST_SHARE, 1.0)))

    def joints(self, active: NDArray[np.intp]) -> list[int]:
        """Return the joints whose limits are among some inequalities."""
        count = len(self.rows[0])
        return sorted({int(index) % count for index in active if index < len(self.bounds) - len(self.pairs)})


def watched_m(travel_m_per_rad: Vector, velocity_rad_s: Vector, max_change: Vector, period_s: float) -> float:
    """Return how far off obstacles must be known for joints, shape (n,) each, to brake before them [m]."""
    fastest = np.abs(velocity_rad_s) + max_change
    braking = BRAKING_SHARE * max_change / period_s
    ahead_rad = fastest * period_s + fastest**2 / (2.0 * braking)
    return max(WATCHED_M, CURVATURE_M + float(travel_m_per_rad @ ahead_rad))


def velocity_bounds(
    q: Vector,
    lower: Vector,
    upper: Vector,
    columns: NDArray[np.intp],
    pairs: Sequence[NearPair],
    limits: ServoLimits,
    max_change: Vector,
    period_s: float,
) -> VelocityBounds:
    """Return bounds for joints in ``columns`` at positions, (n,) [rad]; ``max_change`` is of a velocity a period."""
    kept = [limits.scene_distance_m if pair.by_object else limits.self_distance_m for pair in pairs]
    watched = [(pair, kept_m) for pair, kept_m in zip(pairs, kept, strict=True) if kept_m is not None]
    by_another_arm = np.array([pair.by_another_arm for pair, _ in watched], dtype=bool)
    left_m = np.array([pair.distance_m - kept_m - CURVATURE_M for pair, kept_m in watched])
    left_m = np.where(by_another_arm, ROOM_SHARE * left_m, left_m)
    distance_gradients = np.array([pair.distance_gradient[columns] for pair, _ in watched]).reshape(-1, len(q))
    gradients = np.vstack((-np.eye(len(q)), np.eye(len(q)), distance_gradients))
    distances = np.concatenate((upper - q, q - lower, left_m))
    found = barrier(distances, gradients, BRAKING_SHARE * max_change, period_s, APPROACH_PER_S)
    retreats = RETREAT_PER_S * np.where(by_another_arm, np.minimum(left_m, 0.0), 0.0)
    bounds = found.bounds + np.concatenate((np.zeros(2 * len(q)), retreats))
    return VelocityBounds(found.rows, bounds, [pair for pair, _ in watched])


def within_reach(wanted: Vector, reach: Vector, limit: Limit) -> Vector:
    """Return the nearest change of velocities to a wanted change that the joints can make, within inequalities.

    Changes have the shape (n,) [rad/s], ``reach`` is the greatest of each joint, and bounds are below 0 where the
    present velocity exceeds its bound. Where the inequalities cannot all be met in one step, the joints come as near to
    that as they can: each inequality may be exceeded, at a cost (an exact penalty would need no less than the greatest
    multiplier).
    """
    rows, left = limit.rows, limit.bounds
    if (rows @ wanted <= left + ROUNDING).all():
        return wanted
    # Only what some change within reach could exceed.
    concerned = np.abs(rows) @ reach > left
    rows, left = rows[concerned], left[concerned]
    size, count = len(wanted), len(left)
    excess = np.maximum(-left, 0.0)
    # Unknown are the change, and by how much each inequality is exceeded more than it is now.
    change, further = np.eye(size, size + count), np.eye(count, size + count, size)
    limit = Limit(
        np.vstack((rows @ change - further, change, -change, -further)),
        np.concatenate((left + excess, reach, reach, excess)),
    )
    found, _ = solve([Task(change, wanted), Task(further, -excess, EXCESS_COST)], ROUNDING, limit)
    return np.asarray(found[:size])


PREDICTION_S = 0.005  # time over which a motion is predicted to tell if it approaches a singularity
EXIT_PREDICTION_S = 0.1  # the way out of one is of second order, so it takes longer to show
NOTICED_M_PER_RAD = 1e-6  # a greater change of the least singular value is no rounding [m/rad]
LEAST_PROGRESS = 0.01  # leaving, the tip must get this share of the way it was to go: less is turning about itself


@dataclass(frozen=True)
class RegularizedMotion:
    """Desired velocity without its part into a singularity, and the regular Jacobian to achieve it."""

    linear_m_s: Vector  # the desired velocity that remains, shape (3,) [m/s]
    jacobian: Vector  # the position's, made regular, shape (3, n) [m/rad]
    free: Vector  # directions of the joints that do not move the tip, shape (n, n - 3)
    status: ServoStatus = ServoStatus.NO_WARNING  # status that the singularity causes


def regularized(
    jacobian: Vector,
    linear_m_s: Vector,
    limits: ServoLimits,
    max_velocity: Vector,
    predict: Callable[[Vector], tuple[Vector, Vector]],
) -> RegularizedMotion:
    """Remove the part into a singularity of a desired velocity, (3,) [m/s]; ``predict`` gives place and Jacobian."""
    left, values, right = np.linalg.svd(jacobian)
    free = np.ascontiguousarray(right[3:].T)
    least = values[0] / limits.singularity_stop
    if values[2] * limits.singularity_slow >= values[0]:
        return RegularizedMotion(linear_m_s, jacobian, free)
    floor = np.array([values[0], max(values[1], least), max(values[2], least)])
    sound = (left * floor) @ right[:3]
    weak = left[:, 2]
    desired = float(weak @ linear_m_s)
    velocity = right[:3].T @ ((left.T @ linear_m_s) / floor)
    fastest = float(np.max(np.abs(velocity) / max_velocity))
    velocity = velocity / max(fastest, 1.0)
    ahead = np.linalg.svd(predict(PREDICTION_S * velocity)[1], compute_uv=False)
    change = float(ahead[2] - values[2])
    share, status = _share(float(values[0] / max(values[2], 1e-12)), change, limits)
    moved_m = predict(EXIT_PREDICTION_S * velocity)[0] - predict(0.0 * velocity)[0]
    if (
        change > NOTICED_M_PER_RAD
        and float(weak @ moved_m) * np.sign(desired) < LEAST_PROGRESS * abs(desired) * EXIT_PREDICTION_S
    ):
        share, status = 0.0, ServoStatus.HALT_FOR_SINGULARITY
    if abs(desired) <= LEAST_PROGRESS * float(np.linalg.norm(linear_m_s)):
        status = ServoStatus.NO_WARNING
    return RegularizedMotion(linear_m_s - (1.0 - share) * desired * weak, sound, free, status)


def _share(condition: float, change: float, limits: ServoLimits) -> tuple[float, ServoStatus]:
    if change > NOTICED_M_PER_RAD:
        return 1.0, ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    if condition >= limits.singularity_stop:
        return 0.0, ServoStatus.HALT_FOR_SINGULARITY
    share = (limits.singularity_stop - condition) / (limits.singularity_stop - limits.singularity_slow)
    return share, ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY


POSITION_DIRECTIONS = 3  # joints that it takes to move a tip in any direction
GAIN_PER_S = 4.0  # an error shrinks to a third in a quarter of a second: ten times the delay from question to servo

# Further than this from its anchor the tip is not drifting but held off, by a limit or an obstacle; the anchor then
# comes along.
MAX_DRIFT_M = 0.02
MAX_DRIFT_RAD = 0.35

HELD_DRIFT_M = 0.005  # while it is held off it is pulled no more than keeps it from sliding away by itself, at 2 cm/s
HALTED = 0.05  # a smaller share of the desired speed counts as halted
GIVEN_UP = 0.1  # a rotation is reported as given up when it lacks more than this share
NOT_KEPT_RAD = math.radians(3.0)  # an orientation is reported as not kept from 3 degrees on

_SINGULARITIES = {
    ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY: "the arm nears a singularity: this direction is slowed",
    ServoStatus.HALT_FOR_SINGULARITY: "the arm is at a singularity: this direction leads nowhere, others are free",
    ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY: "the arm leaves a singularity",
}

# Keeps joints from running where it does hardly anything; a hundredth of what an arm's tip moves by [m/rad].
POSITION_DAMPING = 0.002

TURN_DAMPING = 0.05  # turns that need more than twenty times their speed of the joints are mostly given up
STEADINESS = 0.5  # weight of keeping the last rotation: without it the rotation flutters between two obstacles

# At a velocity bound the tip could go on by turning about the obstacle. A turn of a radian costs as much as this way,
# so that the tip stops instead [m/rad].
PUSHED_TURN_M = 0.15


@dataclass(frozen=True)
class ServoState:
    """State of the arm for which velocities are computed: of all joints ``q``, and of those that may move the rest."""

    q: Vector  # shape (n,) [rad]
    columns: NDArray[np.intp]  # places of the joints that may move, shape (m,)
    jacobian: Vector  # of the tip, shape (6, m)
    max_velocity: Vector  # shape (m,) [rad/s]
    max_change: Vector  # of velocities until the next request, shape (m,) [rad/s]
    velocity_rad_s: Vector  # last commanded velocities, shape (m,) [rad/s]
    tip: pin.SE3  # its pose in the root link
    velocity_bounds: VelocityBounds  # barriers


def answer_servo(
    question: ServoQuestion, robot: RobotModel, collision: CollisionModel, forward: ForwardKinematics
) -> ServoAnswer:
    """Return the joint velocities for a command; PlanningError: the question is refused."""
    check_servo_question(robot, question)
    state = _servo_state(question, robot, collision, forward)
    names = robot.groups[question.group].joints
    match question.command:
        case JointVelocities() as command:
            outcome = _joint_outcome(command, names, state)
        case TipTwist() as command:
            outcome = _tip_outcome(question, twist_motion(command, state.tip, question.anchor), state, forward)
        case TipTarget() as command:
            outcome = _tip_outcome(question, target_motion(command, state.tip, question.limits), state, forward)
    return servo_answer(question, names, _ramped(outcome, state), state.velocity_bounds)


def _servo_state(
    question: ServoQuestion, robot: RobotModel, collision: CollisionModel, forward: ForwardKinematics
) -> ServoState:
    q = np.array([question.positions_rad[name] for name in collision.joint_names])
    names, limits = robot.groups[question.group].joints, question.limits
    columns = np.array([collision.joint_names.index(name) for name in names])
    lower, upper = collision.lower_rad[columns], collision.upper_rad[columns]
    joints = [robot.joints[name] for name in names]
    max_change = ACCELERATION_SHARE * question.period_s * np.array([joint.max_acceleration for joint in joints])
    velocity_rad_s = np.array([question.velocity_rad_s.get(name, 0.0) for name in names])
    ahead_m = watched_m(collision.travel_m_per_rad[columns], velocity_rad_s, max_change, question.period_s)
    pairs = collision.near_pairs(q, ahead_m, names)
    bounds = velocity_bounds(q[columns], lower, upper, columns, pairs, limits, max_change, question.period_s)
    jacobian = forward.jacobian(q, question.link)[:, columns]
    return ServoState(
        q,
        columns,
        jacobian,
        limits.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
        max_change,
        velocity_rad_s,
        forward.placement(question.link).copy(),
        bounds,
    )


def _joint_outcome(command: JointVelocities, names: tuple[str, ...], state: ServoState) -> Outcome:
    """Return the outcome of a joint command: only named joints move, also where others could help past a bound."""
    desired = np.array([command.velocity_rad_s.get(name, 0.0) for name in names])
    desired = desired * _share_of_speed(desired, state.max_velocity)
    desired = desired * state.velocity_bounds.share_towards_arms(desired)
    named = np.eye(len(names))[:, desired != 0.0]
    velocity, active = solve([Task(np.eye(len(names)), desired)], POSITION_DAMPING, state.velocity_bounds, free=named)
    return Outcome(velocity, active, desired, velocity)


def _tip_outcome(
    question: ServoQuestion, desired: DesiredMotion, state: ServoState, forward: ForwardKinematics
) -> Outcome:
    linear, angular = state.jacobian[:3], state.jacobian[3:]

    def predict(step: Vector) -> tuple[Vector, Vector]:
        q = state.q.copy()
        q[state.columns] += step
        jacobian = forward.jacobian(q, question.link)[:3, state.columns]
        return forward.placement(question.link).translation.copy(), jacobian

    sound = regularized(linear, desired.linear_m_s, question.limits, state.max_velocity, predict)
    first, active = _moved(sound, angular, desired.angular_rad_s, state)
    velocity, also = _turned(first, angular, desired.angular_rad_s, sound.free, state)
    held = bool(active.size) or sound.status is not ServoStatus.NO_WARNING
    return Outcome(
        velocity,
        np.union1d(active, also),
        desired.linear_m_s,
        linear @ velocity,
        desired.angular_rad_s,
        angular @ velocity,
        sound.status,
        desired.drift_rad,
        relaxed_anchor(desired.anchor, state.tip) if held and desired.anchor is not None else desired.anchor,
    )


def _moved(
    sound: RegularizedMotion, angular: Vector, turn: Vector, state: ServoState
) -> tuple[Vector, NDArray[np.intp]]:
    """Return the joint velocities that move the tip, and the indices of the active velocity bounds."""
    position = Task(sound.jacobian, sound.linear_m_s)
    first, active = solve([position], POSITION_DAMPING, state.velocity_bounds)
    if state.velocity_bounds.near(active):
        both = [position, Task(angular, turn, PUSHED_TURN_M)]
        first, active = solve(both, POSITION_DAMPING, state.velocity_bounds)
    return first * _share_of_speed(first, state.max_velocity), active


def _turned(
    first: Vector, angular: Vector, turn: Vector, free: Vector, state: ServoState
) -> tuple[Vector, NDArray[np.intp]]:
    """Add velocities that turn the tip without moving it; return all, and the indices of the active velocity bounds."""
    steady = Task(free.T, free.T @ state.velocity_rad_s, STEADINESS)
    limit = state.velocity_bounds.also(velocity_limit(state.max_velocity))
    velocity, active = solve([Task(angular, turn), steady], TURN_DAMPING, limit, first, free)
    return velocity, active[active < len(state.velocity_bounds.bounds)]


def _ramped(outcome: Outcome, state: ServoState) -> Outcome:
    """Limit the change of the joints' velocities.

    All joints change alike where the velocity bounds allow it: the tip keeps its direction while the slowest joint
    speeds up. Elsewhere a joint that reverses would hold up another's braking, so that each joint changes as fast as
    the bounds need.
    """
    change = outcome.velocity_rad_s - state.velocity_rad_s
    wanted = change / max(1.0, float(np.max(np.abs(change) / state.max_change)))
    # A joint that rests, and is to rest, helps no other.
    reach = np.where((state.velocity_rad_s != 0.0) | (outcome.velocity_rad_s != 0.0), state.max_change, 0.0)
    rows, bounds = state.velocity_bounds.rows, state.velocity_bounds.bounds
    change = within_reach(wanted, reach, Limit(rows, bounds - rows @ state.velocity_rad_s))
    return replace(outcome, velocity_rad_s=state.velocity_rad_s + change)


def _share_of_speed(velocity: Vector, max_velocity: Vector) -> float:
    """Return the common scale that brings a motion's fastest joint within its limit."""
    return 1.0 / max(1.0, float(np.max(np.abs(velocity) / max_velocity)))


def check_servo_question(robot: RobotModel, question: ServoQuestion) -> None:
    """Check names and numbers of a request."""
    known, command = check_group(robot, question.group).joints, question.command
    check_link(robot, question.link)
    if not isinstance(command, JointVelocities) and len(known) < POSITION_DIRECTIONS:
        text = f"group {question.group!r} has {len(known)} joints; to steer a tip it takes {POSITION_DIRECTIONS}"
        raise PlanningError(PlanningFailure(MoveItErrorCode.INVALID_GROUP_NAME, text, {"group": question.group}))
    check_start(robot, question.positions_rad)
    match command:
        case JointVelocities():
            for name in command.velocity_rad_s:
                if name not in known:
                    raise invalid_goal(f"joint {name!r} is not of group {question.group!r}: {', '.join(known)}")
            values = list(command.velocity_rad_s.values())
        case TipTwist():
            values = [*command.linear_m_s, *command.angular_rad_s]
        case TipTarget():
            values = [*command.pose.position_m, *command.pose.orientation]
            check_length(command.pose.orientation, "target's orientation")
    if not 0.0 < question.period_s <= MAX_PERIOD_S:
        raise invalid_goal(f"the period must be above 0 and at most {MAX_PERIOD_S} s, not {question.period_s:g}")
    for value in (*values, *question.velocity_rad_s.values()):
        if not math.isfinite(value):
            raise invalid_goal(f"a command must be of finite numbers, not {value}")


@dataclass(frozen=True)
class DesiredMotion:
    """Commanded motion of the tip, along the root link's axes."""

    linear_m_s: Vector  # its velocity, shape (3,) [m/s]
    angular_rad_s: Vector  # its angular velocity, shape (3,) [rad/s]
    drift_rad: float  # angle to its anchor or target [rad]
    anchor: Anchor | None  # the next anchor; None where there is nothing to keep


def twist_motion(command: TipTwist, tip: pin.SE3, anchor: Anchor | None) -> DesiredMotion:
    """Return the desired motion of a twist; directions that it does not command are held, from no anchor at first."""
    linear, angular = np.array(command.linear_m_s), np.array(command.angular_rad_s)
    along, about = _unit_or_zero(linear), _unit_or_zero(angular)
    kept = anchor or Anchor(as_pose(tip))
    if command.zero:
        # It still brakes: along its last motion it need not come back.
        along, about = np.array(kept.along), np.array(kept.about)
    # An orientation out of reach would keep the arm moving without a command.
    righting_per_s = 0.0 if command.zero else GAIN_PER_S
    at = placement(kept.pose)
    drift = _shortened(_across(at.translation - tip.translation, along), MAX_DRIFT_M)
    turned = _shortened(_across(pin.log3(at.rotation @ tip.rotation.T), about), MAX_DRIFT_RAD)
    place = pin.SE3(pin.exp3(turned) @ tip.rotation, tip.translation + drift)
    return DesiredMotion(
        linear + GAIN_PER_S * drift,
        angular + righting_per_s * turned,
        float(np.linalg.norm(turned)),
        Anchor(as_pose(place), as_point(along), as_point(about)),
    )


def relaxed_anchor(anchor: Anchor, tip: pin.SE3) -> Anchor:
    """Return the anchor of a tip that limits hold back: pulled to its path, it could not go where it is free to."""
    drift = _shortened(placement(anchor.pose).translation - tip.translation, HELD_DRIFT_M)
    return Anchor(as_pose(pin.SE3(tip.rotation, tip.translation + drift)), anchor.along, anchor.about)


def target_motion(command: TipTarget, tip: pin.SE3, limits: ServoLimits) -> DesiredMotion:
    """Return the desired motion towards a target, within the speed limits."""
    target = placement(command.pose)
    missing_m, missing_rad = target.translation - tip.translation, pin.log3(target.rotation @ tip.rotation.T)
    return DesiredMotion(
        _shortened(GAIN_PER_S * missing_m, limits.linear_m_s),
        _shortened(GAIN_PER_S * missing_rad, limits.angular_rad_s),
        float(np.linalg.norm(missing_rad)),
        None,
    )


def _unit_or_zero(vector: Vector) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.zeros(3)


def _across(vector: Vector, direction: Vector) -> Vector:
    return np.asarray(vector - (vector @ direction) * direction)


def _shortened(vector: Vector, longest: float) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)


@dataclass(frozen=True)
class Outcome:
    """The commanded velocity and the achieved one."""

    velocity_rad_s: Vector  # of the joints that may move, shape (n,) [rad/s]
    active: NDArray[np.intp]  # indices of the active velocity bounds
    desired: Vector  # velocity of the tip [m/s], or of the joints [rad/s]
    achieved: Vector  # the achieved velocity of the same
    # Desired angular velocity of the tip, shape (3,) [rad/s].
    desired_turn_rad_s: Vector = field(default_factory=lambda: np.zeros(3))
    turn_rad_s: Vector = field(default_factory=lambda: np.zeros(3))  # the achieved angular velocity, shape (3,) [rad/s]
    singularity: ServoStatus = ServoStatus.NO_WARNING  # status that a singularity causes
    drift_rad: float = 0.0  # angle between the tip and the desired orientation [rad]
    anchor: Anchor | None = None  # for the next request; None where there is nothing to keep

    @property
    def share(self) -> float:
        """Achieved share of the commanded speed, in its direction, 0 to 1."""
        square = float(self.desired @ self.desired)
        return min(max(float(self.achieved @ self.desired) / square, 0.0), 1.0) if square > 0.0 else 1.0


def servo_answer(
    question: ServoQuestion, names: tuple[str, ...], outcome: Outcome, bounds: VelocityBounds
) -> ServoAnswer:
    """Return the answer for an outcome."""
    status, reasons = _active_limits(names, outcome, bounds)
    reasons += _unachieved(question, outcome, len(names))
    velocity_rad_s = dict(zip(names, outcome.velocity_rad_s.tolist(), strict=True))
    return ServoAnswer(velocity_rad_s, status, "; ".join(reasons), outcome.share, outcome.anchor)


def _active_limits(names: tuple[str, ...], outcome: Outcome, bounds: VelocityBounds) -> tuple[ServoStatus, list[str]]:
    """Return the reasons for a reduced speed: the gravest as the status, all of them in words."""
    status, reasons = ServoStatus.NO_WARNING, []
    joints, pairs = bounds.joints(outcome.active), bounds.near(outcome.active)
    if joints:
        status = ServoStatus.JOINT_BOUND
        reasons.append(f"{', '.join(names[joint] for joint in joints)} at the limit: the others go on")
    if outcome.singularity is not ServoStatus.NO_WARNING:
        status = outcome.singularity
        reasons.append(_SINGULARITIES[status])
    if pairs:
        halted = outcome.share < HALTED
        status = ServoStatus.HALT_FOR_COLLISION if halted else ServoStatus.DECELERATE_FOR_COLLISION
        near = ", ".join(f"{pair.first} and {pair.second} ({1000.0 * pair.distance_m:.0f} mm)" for pair in pairs)
        reasons.append(f"near each other: {near}; what brings them nearer is {'held' if halted else 'slowed'}")
    return status, reasons


def _unachieved(question: ServoQuestion, outcome: Outcome, joints: int) -> list[str]:
    """Describe the part of a rotation, or of the orientation, that cannot be achieved."""
    if isinstance(question.command, TipTwist) and any(question.command.angular_rad_s):
        commanded = float(np.linalg.norm(question.command.angular_rad_s))
        missing = float(np.linalg.norm(outcome.desired_turn_rad_s - outcome.turn_rad_s))
        if missing > GIVEN_UP * commanded:
            return [
                f"of the turn of {commanded:.2f} rad/s, {missing:.2f} rad/s are given up: {joints} joints cannot do it"
            ]
    if outcome.drift_rad > NOT_KEPT_RAD:
        return [f"the orientation is {math.degrees(outcome.drift_rad):.0f} degrees off: the position comes first"]
    return []
