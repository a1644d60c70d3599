"""Answers the questions of who steers the arm: the tip's position first, its orientation as far as it goes.

First the joints are found that give the tip its velocity within all walls; then, among the motions that leave that as
it is, those that turn it best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.collision import CollisionModel
from planners.geometry.forward import ForwardKinematics
from planners.problem import PlanningFailure
from planners.servo.checks import check_servo_question
from planners.servo.least_squares import bounded_least_squares
from planners.servo.question import JointVelocities, ServoAnswer, ServoQuestion, ServoStatus, TipTwist
from planners.servo.report import Outcome, answer_of
from planners.servo.singularity import Ahead, Regular, regular
from planners.servo.walls import WATCHED_M, Walls, walls
from planners.servo.wish import Wish, aimed, loosened, steered
from robot.description.model import RobotModel

Vector = NDArray[np.float64]

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
    """Where the arm is asked about.

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
    """How much of a motion is left when its fastest joint is brought within its limit, all alike."""
    return 1.0 / max(1.0, float(np.max(np.abs(velocity) / max_velocity)))
