"""What became of a wish, told as moveit_msgs/ServoStatus tells it, and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planners.servo.question import Anchor, ServoAnswer, ServoQuestion, ServoStatus, TipTwist
from planners.servo.walls import Walls

Vector = NDArray[np.float64]

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
    """What was wanted and what is had.

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
        """How much of the speed wanted is had, in its direction, 0 to 1."""
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
    """What holds the arm back: the gravest as the status, all of it in words."""
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
    """What of a turn, or of the orientation, cannot be had."""
    if isinstance(question.command, TipTwist) and any(question.command.angular_rad_s):
        asked = float(np.linalg.norm(question.command.angular_rad_s))
        missing = float(np.linalg.norm(outcome.wanted_turn_rad_s - outcome.turn_rad_s))
        if missing > GIVEN_UP * asked:
            return [f"of the turn of {asked:.2f} rad/s, {missing:.2f} rad/s are given up: {joints} joints cannot do it"]
    if outcome.drift_rad > NOT_KEPT_RAD:
        return [f"the orientation is {math.degrees(outcome.drift_rad):.0f} degrees off: the position comes first"]
    return []
