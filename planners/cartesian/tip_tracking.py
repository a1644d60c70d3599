"""Joint positions for the next pose of a tip, from those for the one before: the position first, then the orientation.

Each step solves the position exactly and uses what freedom is left for the orientation, after Siciliano & Slotine,
"A general framework for managing multiple tasks in highly redundant robotic systems", 1991. placo weighs both
against each other instead: an arm of five joints would leave the path for the sake of an orientation it cannot have.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.forward import ForwardKinematics

Vector = NDArray[np.float64]

# Nearer is below what any servo resolves.
ACCURACY_M = 1e-6

# A step that moves no joint by more ends the orientation's descent.
SETTLED_RAD = 3e-4

# Neighbouring poses take two or three steps; only where a pose is out of reach are there many.
MAX_STEPS = 25

# Damping of the position's least squares: singular values of an arm's Jacobian are around 0.1 m/rad and this only
# matters where one vanishes.
POSITION_DAMPING_M = 1e-4

# Damping of the orientation's least squares where it can be met; where it cannot, the damping's square is the angle
# that is missing, which makes the descent to the nearest one converge (Sugihara, "Solvability-unconcerned inverse
# kinematics by the Levenberg-Marquardt method", 2011).
ORIENTATION_DAMPING = 0.02

# Joints are slowed down this near to a limit, so that they do not meet it with a jolt (Chan & Dubey, "A weighted
# least-norm solution based scheme for avoiding joint limits", 1995).
NEAR_LIMIT_RAD = 0.2

# The curve through the points may pass a limit by a little where a joint stops.
LIMIT_MARGIN_RAD = 1e-3

# Linear prediction is poor further away.
LONGEST_STEP_RAD = 0.2


class TipTracker:
    """Follows a pose with some of the joints.

    Args:
        kinematics: of the robot.
        limits: lower and upper positions of all joints, shape (joints,) each [rad].
        columns: where the joints that may move are among all; points have them in this order, shape (n,) [rad].
        start_q: positions of all joints; those that may not move stay there [rad].
        link: the tip.
    """

    def __init__(
        self,
        kinematics: ForwardKinematics,
        limits: tuple[Vector, Vector],
        columns: Sequence[int],
        start_q: Vector,
        link: str,
    ) -> None:
        self._kinematics = kinematics
        self._columns = np.array(columns)
        self._link = link
        self._q = start_q.copy()
        self._limits = limits[0][self._columns], limits[1][self._columns]
        self._lower_rad = self._limits[0] + LIMIT_MARGIN_RAD
        self._upper_rad = self._limits[1] - LIMIT_MARGIN_RAD

    def pose(self, point: Vector) -> pin.SE3:
        """Pose of the tip in the root link's frame."""
        self._q[self._columns] = point
        self._kinematics.place(self._q)
        return self._kinematics.placement(self._link).copy()

    def outside(self, points: Vector) -> NDArray[np.bool_]:
        """Which joints of which points are beyond their limits, shape (m, n)."""
        return np.asarray((points < self._limits[0]) | (points > self._limits[1]))

    def speed_m(self, point: Vector, tangent: Vector) -> float:
        """How far the tip moves per motion of the joints along ``tangent``."""
        return float(np.linalg.norm(self._jacobian(point)[:3] @ tangent))

    def follow(self, point: Vector, target: pin.SE3, most_turn_rad: float) -> Vector:
        """The point nearby with the tip in the target's position, its orientation as near as can be; within limits.

        Args:
            point: where the joints are.
            target: where the tip shall be. One out of reach leaves the tip where it comes nearest, as far as descent
                from here finds out.
            most_turn_rad: by so much any joint may move for the orientation's sake [rad].
        """
        point = point.copy()
        for _ in range(MAX_STEPS):
            missing_m, missing_rad, jacobian = self._missing(point, target)
            step, turn = self._step(point, missing_m, missing_rad, jacobian)
            turn *= min(1.0, most_turn_rad / max(float(np.max(np.abs(turn))), 1e-12))
            most_turn_rad -= float(np.max(np.abs(turn)))
            step += turn
            step *= min(1.0, LONGEST_STEP_RAD / max(float(np.max(np.abs(step))), LONGEST_STEP_RAD))
            settled = float(np.max(np.abs(step))) < SETTLED_RAD
            if settled and float(np.linalg.norm(missing_m)) < ACCURACY_M:
                break
            point = np.clip(point + step, self._lower_rad, self._upper_rad)
            if settled:
                break
        return point

    def _missing(self, point: Vector, target: pin.SE3) -> tuple[Vector, Vector, Vector]:
        """From the tip to a target in position and orientation, along the root link's axes, and the Jacobian there."""
        jacobian = self._jacobian(point)
        placement = self._kinematics.placement(self._link)
        turn = pin.log3(placement.rotation.T @ target.rotation)
        return target.translation - placement.translation, placement.rotation @ turn, jacobian

    def _jacobian(self, point: Vector) -> Vector:
        self._q[self._columns] = point
        return np.asarray(self._kinematics.jacobian(self._q, self._link)[:, self._columns])

    def _step(self, point: Vector, missing_m: Vector, missing_rad: Vector, jacobian: Vector) -> tuple[Vector, Vector]:
        """The steps for position and orientation, of joints near their limits only where the others cannot do it."""
        weight = np.ones_like(point)
        for _ in range(len(point)):
            step, turn = _prioritized(weight * jacobian, missing_m, missing_rad)
            step, turn = weight * step, weight * turn
            room = np.where(step + turn < 0.0, point - self._lower_rad, self._upper_rad - point)
            allowed = np.sqrt(np.clip(room / NEAR_LIMIT_RAD, 0.0, 1.0))
            if np.all(allowed >= weight):
                break
            weight = np.minimum(weight, allowed)
        return step, turn


def _prioritized(jacobian: Vector, missing_m: Vector, missing_rad: Vector) -> tuple[Vector, Vector]:
    """The step that meets the position, and what freedom it leaves used for the orientation."""
    linear, angular = jacobian[:3], jacobian[3:]
    inverse = _damped_inverse(linear, POSITION_DAMPING_M)
    step = inverse @ missing_m
    free = angular - (angular @ inverse) @ linear
    missing_rad = missing_rad - angular @ step
    damping = float(np.sqrt(ORIENTATION_DAMPING**2 + np.linalg.norm(missing_rad)))
    turn = _damped_inverse(free, damping) @ missing_rad
    # Damping lets this leave the position's null space by a little: taken out again.
    return step, turn - inverse @ (linear @ turn)


def _damped_inverse(matrix: Vector, damping: float) -> Vector:
    """Least-squares inverse, shape (n, 3), that stays finite where the matrix loses rank."""
    return np.asarray(np.linalg.solve(matrix @ matrix.T + damping**2 * np.eye(3), matrix).T)
