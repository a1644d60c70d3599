"""Inverse kinematics by placo: from a configuration to one nearby in which conditions hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import placo
from numpy.typing import NDArray

from planners.geometry.forward import ForwardKinematics
from planners.ik.conditions import Condition, JointCondition, PointCondition
from planners.ik.constraints import ConditionSet, Wish
from planners.ik.tasks import JointTask, LinkTask, link_task, slides, with_targets
from robot.description.model import Group, RobotModel

Vector = NDArray[np.float64]

# Weight of standing still against 1 for reaching. Far from the target it must be felt: joints that barely move the tip
# would otherwise be driven into their limits. Near to it, it would only slow the descent down: so it shrinks with the
# square of what is missing, after Levenberg and Marquardt.
STANDING_PER_M2 = 1.0
LEAST_STANDING = 1e-7
MOST_STANDING = 1e-3

# Convergence takes 5-10 steps within reach and up to 40 at its edge.
MAX_STEPS = 60

# A descent that has not come nearer by this share in so many steps has arrived at its nearest point.
LEAST_GAIN = 0.005
PATIENCE = 5

# Reached this well the rest is below the servos' 1.5 mrad, however wide the goal's tolerance.
ACCURACY_M = 1e-4

# What is preferred gets this share of the weight of what is required; a second descent without it makes up for what it
# has cost.
PREFERENCE = 0.01

# Of a tolerance, where its middle cannot be had: the rest keeps rounding from the edge.
INNER_SHARE = 0.9
MIDDLE = 0.0


@dataclass(frozen=True)
class _Body:
    """placo's model of the robot, and where configurations are in it."""

    wrapper: placo.RobotWrapper
    forward: ForwardKinematics
    joint_names: Sequence[str]
    columns: NDArray[np.int64]
    lower_rad: Vector
    upper_rad: Vector


class Kinematics:
    """Inverse kinematics of one robot.

    Args:
        robot: the arm.
        forward: places its links.
        joint_names: joints of a configuration ``q``, shape (n,) [rad].
    """

    def __init__(self, robot: RobotModel, forward: ForwardKinematics, joint_names: Sequence[str]) -> None:
        # placo leaks some 0.16 MB per wrapper, so there is one for life.
        wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, with_targets(robot))
        self._body = _Body(
            wrapper,
            forward,
            joint_names,
            np.array([wrapper.get_joint_offset(name) for name in joint_names]),
            np.array([robot.joints[name].lower for name in joint_names]),
            np.array([robot.joints[name].upper for name in joint_names]),
        )

    def descent(self, group: Group, wish: Wish) -> Descent:
        """What brings configurations to where a wish is met, or as near as possible.

        Args:
            group: the joints that may move; the others stay.
            wish: at most :data:`planners.ik.tasks.MAX_POINTS` conditions on points.
        """
        return Descent(self._body, group, wish)


class Descent:
    """Moves configurations to ones nearby in which a wish is met, or as near as possible; within limits."""

    def __init__(self, body: _Body, group: Group, wish: Wish) -> None:
        required = [(condition, 1.0) for condition in wish.required]
        preferred = [(condition, PREFERENCE) for condition in wish.preferred]
        self._required = _Solver(body, group, required)
        self._both = _Solver(body, group, [*required, *preferred]) if preferred else None
        self._holds = ConditionSet(body.forward, wish.required).holds

    def __call__(self, q: Vector) -> Vector:
        """Descend from a configuration: to the middle of every tolerance, or else anywhere inside."""
        if self._both is not None:
            q = self._both.descend(q, MIDDLE)
        q = self._required.descend(q, MIDDLE)
        return q if self._holds(q) else self._required.descend(q, INNER_SHARE)

    def inside(self, q: Vector) -> Vector | None:
        """The configuration nearby in which all that is required holds, if the descent from here finds one."""
        q = self._required.descend(q, INNER_SHARE)
        return q if self._holds(q) else None


class _Solver:
    """Minimizes what is missing to conditions, each with its share of the weight."""

    def __init__(self, body: _Body, group: Group, shares: Sequence[tuple[Condition, float]]) -> None:
        self._body = body
        self._solver = body.wrapper.make_solver()
        # Otherwise the base flies to the target.
        self._solver.mask_fbase(True)
        for name in [*(name for name in body.joint_names if name not in group.joints), *slides()]:
            self._solver.mask_dof(name)
        self._solver.enable_joint_limits(True)
        self._standing = self._solver.add_regularization_task(MOST_STANDING)
        self._joint_tasks: list[JointTask] = []
        self._link_tasks: list[LinkTask] = []
        # Conditions on points come first: there are targets for the first few tasks only.
        shares = sorted(shares, key=lambda pair: not isinstance(pair[0], PointCondition))
        for index, (condition, share) in enumerate(shares):
            weight = share * condition.weight
            if isinstance(condition, JointCondition):
                self._joint_tasks.append(JointTask(self._solver, condition, weight, index))
            else:
                self._link_tasks.append(link_task(body.wrapper, self._solver, condition, weight, index))

    def descend(self, q: Vector, share: float) -> Vector:
        """Descend from a configuration towards a share of every tolerance."""
        wrapper, columns = self._body.wrapper, self._body.columns
        wrapper.state.q[columns] = q
        least_m, idle = math.inf, 0
        for _ in range(MAX_STEPS):
            missing_m = self._aim(q, share)
            idle = idle + 1 if missing_m > (1.0 - LEAST_GAIN) * least_m else 0
            if missing_m < ACCURACY_M or idle > PATIENCE:
                break
            least_m = min(least_m, missing_m)
            self._standing.set_weight(min(MOST_STANDING, max(LEAST_STANDING, STANDING_PER_M2 * missing_m**2)))
            wrapper.update_kinematics()
            self._solver.solve(True)
            # The solver keeps limits to its own accuracy only.
            q = np.minimum(np.maximum(wrapper.state.q[columns], self._body.lower_rad), self._body.upper_rad)
        return q

    def _aim(self, q: Vector, share: float) -> float:
        """Set all targets; what is missing to them together [m]."""
        forward = self._body.forward
        forward.place(q)
        missing_m = [task.aim(forward.placement(task.condition.link), share) for task in self._link_tasks]
        missing_m += [task.aim(float(q[task.condition.column]), share) for task in self._joint_tasks]
        return math.hypot(*missing_m)
