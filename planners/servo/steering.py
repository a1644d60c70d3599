"""Servoing: from a commanded twist or joint velocity to joint velocities, many times a second.

First the joint velocities are found that give the tip its linear velocity within all limits; then, among those that
leave it as it is, the ones that turn the tip best. The outcome is reported as moveit_msgs/ServoStatus, and in words.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.checks import check_group, check_start
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import placement
from planners.ik.goal_checks import invalid_goal
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Point, Pose
from planners.servo.question import (
    Anchor,
    JointVelocities,
    ServoAnswer,
    ServoLimits,
    ServoQuestion,
    ServoStatus,
    TipTarget,
    TipTwist,
)
from planners.servo.velocity_limits import WATCHED_M, Ahead, Regular, Walls, bounded_least_squares, regular, walls
from robot.description.model import RobotModel
from robot.trajectory import Vector

# The tip's position has so many directions; an arm with fewer joints cannot be steered by its tip.
POSITION_DIRECTIONS = 3

# Who asks more rarely does not steer.
MAX_PERIOD_S = 0.1

# A quaternion whose length is further from 1 is none.
UNIT_TOLERANCE = 1e-3


def check_servo_question(robot: RobotModel, question: ServoQuestion) -> PlanningFailure | None:
    """Names and numbers of a question."""
    return (
        check_group(robot, question.group)
        or next(_link_flaws(robot, question), None)
        or check_start(robot, question.positions_rad)
        or next(_command_flaws(robot, question), None)
    )


def _link_flaws(robot: RobotModel, question: ServoQuestion) -> Iterator[PlanningFailure]:
    if question.link not in robot.links:
        yield PlanningFailure(
            MoveItErrorCode.INVALID_LINK_NAME,
            f"there is no link {question.link!r}; there are: {', '.join(robot.links)}",
            {"link": question.link},
        )
    joints = robot.groups[question.group].joints
    if not isinstance(question.command, JointVelocities) and len(joints) < POSITION_DIRECTIONS:
        yield PlanningFailure(
            MoveItErrorCode.INVALID_GROUP_NAME,
            f"group {question.group!r} has {len(joints)} joints; to steer a tip it takes {POSITION_DIRECTIONS}",
            {"group": question.group},
        )


def _command_flaws(robot: RobotModel, question: ServoQuestion) -> Iterator[PlanningFailure]:
    command = question.command
    match command:
        case JointVelocities():
            known = robot.groups[question.group].joints
            for name in command.velocity_rad_s:
                if name not in known:
                    yield invalid_goal(f"joint {name!r} is none of group {question.group!r}: {', '.join(known)}")
            values = list(command.velocity_rad_s.values())
        case TipTwist():
            values = [*command.linear_m_s, *command.angular_rad_s]
        case TipTarget():
            values = [*command.pose.position_m, *command.pose.orientation]
            if abs(math.hypot(*command.pose.orientation) - 1.0) > UNIT_TOLERANCE:
                yield invalid_goal(f"the target's orientation {command.pose.orientation} is no unit quaternion")
    if not 0.0 < question.period_s <= MAX_PERIOD_S:
        yield invalid_goal(f"the period must be above 0 and at most {MAX_PERIOD_S} s, not {question.period_s:g}")
    for value in (*values, *question.velocity_rad_s.values()):
        if not math.isfinite(value):
            yield invalid_goal(f"a command must be of finite numbers, not {value}")


# An error shrinks to a third in a quarter of a second: ten times the delay from question to servo.
GAIN_PER_S = 4.0

# Further than this from its anchor the tip is not drifting but held off, by a limit or by what is in the way; the
# anchor then comes along.
MAX_DRIFT_M = 0.02
MAX_DRIFT_RAD = 0.35

# While it is held off it is pulled no more than keeps it from sliding away by itself, at 2 cm/s.
HELD_DRIFT_M = 0.005


@dataclass(frozen=True)
class Wish:
    """Commanded motion of the tip, along the root link's axes.

    Attributes:
        linear_m_s: its velocity, shape (3,) [m/s].
        angular_rad_s: its angular velocity, shape (3,) [rad/s].
        drift_rad: how far it is turned from its anchor or target [rad].
        anchor: what to keep from now on; None where there is nothing to keep.
    """

    linear_m_s: Vector
    angular_rad_s: Vector
    drift_rad: float
    anchor: Anchor | None


def steered(command: TipTwist, tip: pin.SE3, anchor: Anchor | None) -> Wish:
    """The wish of a twist: what it does not move is held where it was.

    Args:
        command: the twist.
        tip: where the tip is.
        anchor: what was kept until now; None at the beginning.
    """
    linear, angular = np.array(command.linear_m_s), np.array(command.angular_rad_s)
    along, about = _direction(linear), _direction(angular)
    kept = anchor or Anchor(_pose(tip))
    if command.zero:
        # It still brakes: what it had been moved along it need not come back for.
        along, about = np.array(kept.along), np.array(kept.about)
    # An orientation that cannot be had would keep an arm moving that nobody moves.
    righting_per_s = 0.0 if command.zero else GAIN_PER_S
    at = placement(kept.pose)
    drift = _shortened(_across(at.translation - tip.translation, along), MAX_DRIFT_M)
    turned = _shortened(_across(pin.log3(at.rotation @ tip.rotation.T), about), MAX_DRIFT_RAD)
    place = pin.SE3(pin.exp3(turned) @ tip.rotation, tip.translation + drift)
    return Wish(
        linear + GAIN_PER_S * drift,
        angular + righting_per_s * turned,
        float(np.linalg.norm(turned)),
        Anchor(_pose(place), _point(along), _point(about)),
    )


def loosened(anchor: Anchor, tip: pin.SE3) -> Anchor:
    """The anchor of a tip that is held back: to be pulled to its way would keep it from going where it can.

    Args:
        anchor: what was to be kept.
        tip: where the tip is.
    """
    drift = _shortened(placement(anchor.pose).translation - tip.translation, HELD_DRIFT_M)
    return Anchor(_pose(pin.SE3(tip.rotation, tip.translation + drift)), anchor.along, anchor.about)


def aimed(command: TipTarget, tip: pin.SE3, limits: ServoLimits) -> Wish:
    """The wish of a target: to be there, not faster than allowed."""
    target = placement(command.pose)
    missing_m, missing_rad = target.translation - tip.translation, pin.log3(target.rotation @ tip.rotation.T)
    return Wish(
        _shortened(GAIN_PER_S * missing_m, limits.linear_m_s),
        _shortened(GAIN_PER_S * missing_rad, limits.angular_rad_s),
        float(np.linalg.norm(missing_rad)),
        None,
    )


def _direction(vector: Vector) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.zeros(3)


def _across(vector: Vector, direction: Vector) -> Vector:
    return np.asarray(vector - (vector @ direction) * direction)


def _shortened(vector: Vector, longest: float) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)


def _pose(place: pin.SE3) -> Pose:
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(place).tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def _point(vector: Vector) -> Point:
    x, y, z = vector.tolist()
    return x, y, z


# Less than this share of the speed that is wanted is no motion.
HALTED = 0.05

# A turn is told as given up when more than this share of it is.
GIVEN_UP = 0.1

# An orientation is told as not kept from 3 degrees on.
NOT_KEPT_RAD = math.radians(3.0)


def _nothing() -> Vector:
    return np.zeros(3)


@dataclass(frozen=True)
class Outcome:
    """The commanded velocity and the achieved one.

    Attributes:
        velocity_rad_s: of the joints that may move, shape (n,) [rad/s].
        active: which of the walls hold them back.
        wanted: velocity of the tip [m/s], or of the joints [rad/s].
        had: likewise.
        wanted_turn_rad_s: angular velocity of the tip that was wanted, shape (3,) [rad/s].
        turn_rad_s: that it has.
        singularity: what a singularity does to it.
        drift_rad: how far the tip is turned from where it should be [rad].
        anchor: what to keep.
    """

    velocity_rad_s: Vector
    active: NDArray[np.intp]
    wanted: Vector
    had: Vector
    wanted_turn_rad_s: Vector = field(default_factory=_nothing)
    turn_rad_s: Vector = field(default_factory=_nothing)
    singularity: ServoStatus = ServoStatus.NO_WARNING
    drift_rad: float = 0.0
    anchor: Anchor | None = None

    @property
    def share(self) -> float:
        """Achieved share of the commanded speed, in its direction, 0 to 1."""
        square = float(self.wanted @ self.wanted)
        return min(max(float(self.had @ self.wanted) / square, 0.0), 1.0) if square > 0.0 else 1.0


def answer_of(question: ServoQuestion, names: tuple[str, ...], outcome: Outcome, around: Walls) -> ServoAnswer:
    """Tell an outcome.

    Args:
        question: what was asked.
        names: the joints of the outcome.
        outcome: what became of it.
        around: what held it back.
    """
    status, said = _held_back(names, outcome, around)
    said += _given_up(question, outcome, len(names))
    return ServoAnswer(
        dict(zip(names, outcome.velocity_rad_s.tolist(), strict=True)),
        status,
        "; ".join(said),
        outcome.share,
        outcome.anchor,
    )


def _held_back(names: tuple[str, ...], outcome: Outcome, around: Walls) -> tuple[ServoStatus, list[str]]:
    """Return the reasons for a reduced speed: the gravest as the status, all of them in words."""
    status, said = ServoStatus.NO_WARNING, []
    joints, pairs = around.joints(outcome.active), around.near(outcome.active)
    if joints:
        status = ServoStatus.JOINT_BOUND
        said.append(f"{', '.join(names[joint] for joint in joints)} at the limit: the others go on")
    if outcome.singularity is not ServoStatus.NO_WARNING:
        status = outcome.singularity
        said.append(_SINGULARITIES[status])
    if pairs:
        halted = outcome.share < HALTED
        status = ServoStatus.HALT_FOR_COLLISION if halted else ServoStatus.DECELERATE_FOR_COLLISION
        near = ", ".join(f"{pair.first} and {pair.second} ({1000.0 * pair.distance_m:.0f} mm)" for pair in pairs)
        said.append(f"near each other: {near}; what brings them nearer is {'held' if halted else 'slowed'}")
    return status, said


_SINGULARITIES = {
    ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY: "the arm nears a singularity: this direction is slowed",
    ServoStatus.HALT_FOR_SINGULARITY: "the arm is at a singularity: this direction leads nowhere, others are free",
    ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY: "the arm leaves a singularity",
}


def _given_up(question: ServoQuestion, outcome: Outcome, joints: int) -> list[str]:
    """Describe the part of a rotation, or of the orientation, that cannot be achieved."""
    if isinstance(question.command, TipTwist) and any(question.command.angular_rad_s):
        asked = float(np.linalg.norm(question.command.angular_rad_s))
        missing = float(np.linalg.norm(outcome.wanted_turn_rad_s - outcome.turn_rad_s))
        if missing > GIVEN_UP * asked:
            return [f"of the turn of {asked:.2f} rad/s, {missing:.2f} rad/s are given up: {joints} joints cannot do it"]
    if outcome.drift_rad > NOT_KEPT_RAD:
        return [f"the orientation is {math.degrees(outcome.drift_rad):.0f} degrees off: the position comes first"]
    return []


# Keeps joints from running where it does hardly anything; a hundredth of what an arm's tip moves by [m/rad].
POSITION_DAMPING = 0.002

# Turns that need more than twenty times their speed of the joints are mostly given up.
TURN_DAMPING = 0.05


# How much a turn stays what it was: it does not flutter between two things that are in its way.
STEADINESS = 0.5

# Share of the joints' acceleration that steering uses; the arm, which rounds the corners, needs some of the rest.
ACCELERATION_SHARE = 0.7

# Against a wall the tip could go on by turning about where it touches. A turn of a radian counts as much as this way:
# then it rather stops [m/rad].
PUSHED_TURN_M = 0.15


@dataclass(frozen=True)
class Place:
    """State of the arm at which velocities are asked for.

    Attributes:
        q: every joint, shape (n,) [rad].
        columns: the joints that may move.
        jacobian: of the tip for these, shape (6, m).
        max_velocity: of these, shape (m,) [rad/s].
        max_change: of their velocities until the next question, shape (m,) [rad/s].
        velocity_rad_s: what these were told last, shape (m,) [rad/s].
        tip: where the tip is.
        walls: for these.
    """

    q: Vector
    columns: NDArray[np.intp]
    jacobian: Vector
    max_velocity: Vector
    max_change: Vector
    velocity_rad_s: Vector
    tip: pin.SE3
    walls: Walls


def answer_servo(
    question: ServoQuestion, robot: RobotModel, collision: CollisionModel, forward: ForwardKinematics
) -> ServoAnswer | PlanningFailure:
    """Say how the joints must move now.

    Args:
        question: what is wanted, and where.
        robot: the arm.
        collision: what is near.
        forward: of the same joints.
    """
    refusal = check_servo_question(robot, question)
    if refusal is not None:
        return refusal
    place = _place(question, robot, collision, forward)
    names = robot.groups[question.group].joints
    if isinstance(question.command, JointVelocities):
        return answer_of(question, names, _ramped(_turn_joints(question.command, names, place), place), place.walls)
    if isinstance(question.command, TipTwist):
        wish = steered(question.command, place.tip, question.anchor)
    else:
        wish = aimed(question.command, place.tip, question.limits)
    return answer_of(question, names, _ramped(_move_tip(question, wish, place, forward), place), place.walls)


def _place(question: ServoQuestion, robot: RobotModel, collision: CollisionModel, forward: ForwardKinematics) -> Place:
    q = np.array([question.positions_rad[name] for name in collision.joint_names])
    names, limits = robot.groups[question.group].joints, question.limits
    columns = np.array([collision.joint_names.index(name) for name in names])
    lower, upper = collision.lower_rad[columns], collision.upper_rad[columns]
    around = walls(q[columns], lower, upper, columns, collision.near_pairs(q, WATCHED_M), limits)
    joints = [robot.joints[name] for name in names]
    jacobian = forward.jacobian(q, question.link)[:, columns]
    return Place(
        q,
        columns,
        jacobian,
        limits.velocity_scaling * np.array([joint.max_velocity for joint in joints]),
        ACCELERATION_SHARE * question.period_s * np.array([joint.max_acceleration for joint in joints]),
        np.array([question.velocity_rad_s.get(name, 0.0) for name in names]),
        forward.placement(question.link).copy(),
        around,
    )


def _turn_joints(command: JointVelocities, names: tuple[str, ...], place: Place) -> Outcome:
    """Only the joints that were named move, also where others could help around a wall."""
    wanted = np.array([command.velocity_rad_s.get(name, 0.0) for name in names])
    wanted = wanted * _share_of_speed(wanted, place.max_velocity)
    named = np.flatnonzero(wanted)
    velocity = np.zeros(len(names))
    if not named.size:
        return Outcome(velocity, np.array([], dtype=np.intp), wanted, velocity)
    found, active = bounded_least_squares(
        np.eye(len(named)), wanted[named], POSITION_DAMPING, place.walls.rows[:, named], place.walls.bounds
    )
    velocity[named] = found
    return Outcome(velocity, active, wanted, velocity)


def _move_tip(question: ServoQuestion, wish: Wish, place: Place, forward: ForwardKinematics) -> Outcome:
    linear, angular = place.jacobian[:3], place.jacobian[3:]

    def ahead(step: Vector) -> Ahead:
        q = place.q.copy()
        q[place.columns] += step
        jacobian = forward.jacobian(q, question.link)[:3, place.columns]
        return Ahead(forward.placement(question.link).translation.copy(), jacobian)

    sound = regular(linear, wish.linear_m_s, question.limits, place.max_velocity, ahead)
    first, active = _moved(sound, angular, wish.angular_rad_s, place)
    velocity, also = _turned(first, angular, wish.angular_rad_s, sound.free, place)
    held = bool(active.size) or sound.status is not ServoStatus.NO_WARNING
    return Outcome(
        velocity,
        np.union1d(active, also),
        wish.linear_m_s,
        linear @ velocity,
        wish.angular_rad_s,
        angular @ velocity,
        sound.status,
        wish.drift_rad,
        loosened(wish.anchor, place.tip) if held and wish.anchor is not None else wish.anchor,
    )


def _moved(sound: Regular, angular: Vector, turn: Vector, place: Place) -> tuple[Vector, NDArray[np.intp]]:
    """The joints' velocities that move the tip, and the walls that hold them back."""
    rows, bounds = place.walls.rows, place.walls.bounds
    first, active = bounded_least_squares(sound.jacobian, sound.linear_m_s, POSITION_DAMPING, rows, bounds)
    if place.walls.near(active):
        both = np.vstack((sound.jacobian, PUSHED_TURN_M * angular))
        wanted = np.concatenate((sound.linear_m_s, PUSHED_TURN_M * turn))
        first, active = bounded_least_squares(both, wanted, POSITION_DAMPING, rows, bounds)
    return first * _share_of_speed(first, place.max_velocity), active


def _turned(
    first: Vector, angular: Vector, turn: Vector, free: Vector, place: Place
) -> tuple[Vector, NDArray[np.intp]]:
    """The same with what turns the tip without moving it, and the walls that hold that back."""
    rows, bounds = place.walls.rows, place.walls.bounds
    speeds = np.concatenate((place.max_velocity - first, place.max_velocity + first))
    rest, active = bounded_least_squares(
        np.vstack((angular @ free, STEADINESS * np.eye(free.shape[1]))),
        np.concatenate((turn - angular @ first, STEADINESS * free.T @ (place.velocity_rad_s - first))),
        TURN_DAMPING,
        np.vstack((rows @ free, free, -free)),
        np.maximum(np.concatenate((bounds - rows @ first, speeds)), 0.0),
    )
    return first + free @ rest, active[active < len(bounds)]


def _ramped(outcome: Outcome, place: Place) -> Outcome:
    """An outcome as it is got to: all joints alike, so that the tip keeps its direction while the slowest speeds up."""
    change = outcome.velocity_rad_s - place.velocity_rad_s
    share = 1.0 / max(1.0, float(np.max(np.abs(change) / place.max_change)))
    return replace(outcome, velocity_rad_s=place.velocity_rad_s + share * change)


def _share_of_speed(velocity: Vector, max_velocity: Vector) -> float:
    """Return the common scale that brings a motion's fastest joint within its limit."""
    return 1.0 / max(1.0, float(np.max(np.abs(velocity) / max_velocity)))
