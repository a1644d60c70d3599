"""Inverse kinematics by placo: from a configuration to one nearby in which conditions hold.

Each condition becomes a task of placo's solver, which gets a new target at every step.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import placo
from numpy.typing import NDArray

from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.plain_urdf import kinematic_urdf
from planners.ik.constraints import (
    AxisCondition,
    Condition,
    ConditionSet,
    GoalConditions,
    JointCondition,
    LinkCondition,
    PointCondition,
    TurnCondition,
    frame_along,
    norm,
)
from robot.description.model import Group, RobotModel
from robot.description.urdf import Mimic
from robot.trajectory import Vector

# Further ahead than this the arm is not nearly linear, and a target far outside would throw it into its limits.
MAX_STEP_M = 0.1
MAX_STEP_RAD = 0.7

# A condition that holds would keep its link where it is while another one pulls: it has this share of its
# weight until it is broken.
RELAXED = 1e-3

# Conditions on points that one goal can have; each costs every goal a microsecond a step.
MAX_POINTS = 4

# placo measures a point of a link from a point of its own model only: such targets stand at the end of three slides
# along x, y and z, longer than any arm.
SLIDE_AXES = ("1 0 0", "0 1 0", "0 0 1")
SLIDE_LENGTH_M = 1e3


_Task = placo.RelativePositionTask | placo.OrientationTask | placo.JointsTask

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


class _Weight:
    """Weight of a task of placo, which is set there when it changes."""

    def __init__(self, task: _Task, name: str, weight: float) -> None:
        self._task, self._name, self._whole = task, name, weight
        self._relaxed = False
        self._tell()

    def relax(self, relaxed: bool) -> None:
        """Reduce the weight of a condition that holds, or restore it."""
        if relaxed != self._relaxed:
            self._relaxed = relaxed
            self._tell()

    def _tell(self) -> None:
        self._task.configure(self._name, "soft", self._whole * (RELAXED if self._relaxed else 1.0))


class LinkTask(ABC):
    """Moves a link until a condition on it holds.

    Attributes:
        condition: the condition.
    """

    max_step = MAX_STEP_RAD

    def __init__(self, condition: LinkCondition, weight: float, name: str, task: _Task) -> None:
        self.condition = condition
        self._scale = condition.arm_m * math.sqrt(weight)
        self._weight = _Weight(task, name, self._scale**2)

    def aim(self, placement: pin.SE3, share: float) -> float:
        """Set the next target.

        Args:
            placement: the link's pose in the root link.
            share: of the condition's tolerance that is to be reached.

        Returns:
            How far that is from here, weighted [m].
        """
        beyond = self.condition.beyond(self.condition.missing(placement), share)
        length = norm(beyond)
        self._go(placement, beyond if length <= self.max_step else beyond * (self.max_step / length))
        self._weight.relax(length == 0.0)
        return self._scale * length

    @abstractmethod
    def _go(self, placement: pin.SE3, step: Vector) -> None:
        """Set the target a step, as the condition measures what is missing, away from a placement."""


class PointTask(LinkTask):
    """Moves a point of a link.

    Args:
        wrapper: placo's model, made from :func:`with_targets`.
        solver: takes the task.
        condition: where to.
        weight: of the task.
        index: of the task in the solver, below :data:`MAX_POINTS`.
    """

    max_step = MAX_STEP_M

    def __init__(
        self,
        wrapper: placo.RobotWrapper,
        solver: placo.KinematicsSolver,
        condition: PointCondition,
        weight: float,
        index: int,
    ) -> None:
        task = solver.add_relative_position_task(condition.link, _carriage(index, 2), condition.offset_m)
        super().__init__(condition, weight, f"point {index}", task)
        self._point = condition
        self._wrapper = wrapper
        self._columns = np.array([wrapper.get_joint_offset(_slide(index, axis)) for axis in range(3)])

    def _go(self, placement: pin.SE3, step: Vector) -> None:
        self._wrapper.state.q[self._columns] = self._point.point(placement) + self._point.axes @ step


class TurnTask(LinkTask):
    """Turns a link.

    Args:
        solver: takes the task.
        condition: where to.
        weight: of the task.
        index: of the task in the solver.
    """

    def __init__(
        self, solver: placo.KinematicsSolver, condition: TurnCondition | AxisCondition, weight: float, index: int
    ) -> None:
        self._task = solver.add_orientation_task(condition.link, np.eye(3))
        super().__init__(condition, weight, f"turn {index}", self._task)

    def _go(self, placement: pin.SE3, step: Vector) -> None:
        self._task.R_world_frame = placement.rotation @ pin.exp3(step)


class AxisTask(TurnTask):
    """Turns an axis of a link and leaves free the turn about it.

    placo's own task for axes divides by zero once they are parallel.

    Args:
        solver: takes the task.
        condition: where to.
        weight: of the task.
        index: of the task in the solver.
    """

    def __init__(self, solver: placo.KinematicsSolver, condition: AxisCondition, weight: float, index: int) -> None:
        super().__init__(solver, condition, weight, index)
        self._across = frame_along(condition.axis)
        self._task.mask.set_axises("xy", "custom")

    def _go(self, placement: pin.SE3, step: Vector) -> None:
        super()._go(placement, step)
        self._task.mask.R_custom_world = (placement.rotation @ self._across).T


class JointTask:
    """Moves a joint into its range.

    Args:
        solver: takes the task.
        condition: where to.
        weight: of the task.
        index: of the task in the solver.

    Attributes:
        condition: the condition.
    """

    def __init__(self, solver: placo.KinematicsSolver, condition: JointCondition, weight: float, index: int) -> None:
        self.condition = condition
        self._scale = condition.arm_m * math.sqrt(weight)
        self._task = solver.add_joints_task()
        self._weight = _Weight(self._task, f"joint {index}", self._scale**2)

    def aim(self, value: float, share: float) -> float:
        """Set the next target, as :meth:`LinkTask.aim`, from a position of the joint [rad]."""
        beyond = self.condition.beyond_rad(value, share)
        self._task.set_joint(joint_in_placo(self.condition.joint), value + beyond)
        self._weight.relax(beyond == 0.0)
        return self._scale * abs(beyond)


def link_task(
    wrapper: placo.RobotWrapper, solver: placo.KinematicsSolver, condition: LinkCondition, weight: float, index: int
) -> LinkTask:
    """The task for a condition on a link; arguments as for :class:`PointTask`."""
    match condition:
        case PointCondition():
            return PointTask(wrapper, solver, condition, weight, index)
        case TurnCondition():
            return TurnTask(solver, condition, weight, index)
        case AxisCondition():
            return AxisTask(solver, condition, weight, index)


def with_targets(robot: RobotModel) -> str:
    """URDF text of a robot's kinematics with the targets of points beside it."""
    root = ET.fromstring(kinematic_urdf(robot))  # noqa: S314 - made from what robot.description.model has parsed
    for joint in root.iterfind("joint"):
        joint.set("name", joint_in_placo(joint.get("name", "")))
    for point in range(MAX_POINTS):
        parent = robot.root_link
        for axis, direction in enumerate(SLIDE_AXES):
            child = _carriage(point, axis)
            ET.SubElement(root, "link", name=child)
            joint = ET.SubElement(root, "joint", name=_slide(point, axis), type="prismatic")
            ET.SubElement(joint, "parent", link=parent)
            ET.SubElement(joint, "child", link=child)
            ET.SubElement(joint, "axis", xyz=direction)
            limits = {"lower": f"{-SLIDE_LENGTH_M}", "upper": f"{SLIDE_LENGTH_M}", "velocity": "1", "effort": "1"}
            ET.SubElement(joint, "limit", limits)
            parent = child
    return ET.tostring(root, encoding="unicode")


def joint_in_placo(name: str) -> str:
    """Return the name of a joint in placo's model, where it may not be that of a link."""
    return f"joint {name}"


def slides() -> list[str]:
    """The joints of the targets: no solver may move them."""
    return [_slide(point, axis) for point in range(MAX_POINTS) for axis in range(len(SLIDE_AXES))]


def _slide(point: int, axis: int) -> str:
    return f"planning_slide_{point}_{axis}"


def _carriage(point: int, axis: int) -> str:
    return f"planning_carriage_{point}_{axis}"


class _Follower:
    """Joint that mimics another one."""

    def __init__(self, wrapper: placo.RobotWrapper, name: str, mimic: Mimic, joint_names: Sequence[str]) -> None:
        self.name, self.leader, self.multiplier = joint_in_placo(name), joint_in_placo(mimic.joint), mimic.multiplier
        self.leader_name = mimic.joint
        self._column, self._leader_column = wrapper.get_joint_offset(self.name), joint_names.index(mimic.joint)

    def place(self, wrapper: placo.RobotWrapper, q: Vector) -> None:
        """Set the joint in placo's model to its position at a configuration."""
        wrapper.state.q[self._column] = self.multiplier * q[self._leader_column]


@dataclass(frozen=True)
class _PlacoModel:
    """placo's model of the robot, and where configurations are in it."""

    wrapper: placo.RobotWrapper
    forward: ForwardKinematics
    joint_names: Sequence[str]
    columns: NDArray[np.int64]
    followers: Sequence[_Follower]
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
        self._body = _PlacoModel(
            wrapper,
            forward,
            joint_names,
            np.array([wrapper.get_joint_offset(joint_in_placo(name)) for name in joint_names]),
            [_Follower(wrapper, name, joint.mimic, joint_names) for name, joint in robot.joints.items() if joint.mimic],
            np.array([robot.joints[name].lower for name in joint_names]),
            np.array([robot.joints[name].upper for name in joint_names]),
        )

    def descent(self, group: Group, goal_conditions: GoalConditions) -> Descent:
        """Return a descent that brings configurations to where conditions hold, or as near as possible.

        Args:
            group: the joints that may move; the others stay.
            goal_conditions: conditions, at most :data:`planners.ik.kinematics.MAX_POINTS` conditions on points.
        """
        return Descent(self._body, group, goal_conditions)


class Descent:
    """Descent from configurations to ones nearby in which conditions hold, or as nearly as possible; within limits."""

    def __init__(self, body: _PlacoModel, group: Group, goal_conditions: GoalConditions) -> None:
        required = [(condition, 1.0) for condition in goal_conditions.required]
        preferred = [(condition, PREFERENCE) for condition in goal_conditions.preferred]
        self._required = _Solver(body, group, required)
        self._both = _Solver(body, group, [*required, *preferred]) if preferred else None
        self._holds = ConditionSet(body.forward, goal_conditions.required).holds

    def __call__(self, q: Vector) -> Vector:
        """Descend from a configuration: to the middle of every tolerance, or else anywhere inside."""
        if self._both is not None:
            q = self._both.descend(q, MIDDLE)
        q = self._required.descend(q, MIDDLE)
        return q if self._holds(q) else self._required.descend(q, INNER_SHARE)

    def inside(self, q: Vector) -> Vector | None:
        """Return a configuration nearby in which all that is required holds; None if the descent finds none."""
        q = self._required.descend(q, INNER_SHARE)
        return q if self._holds(q) else None


class _Solver:
    """Minimizes what is missing to conditions, each with its share of the weight."""

    def __init__(self, body: _PlacoModel, group: Group, shares: Sequence[tuple[Condition, float]]) -> None:
        self._body = body
        self._solver = body.wrapper.make_solver()
        # Otherwise the base flies to the target.
        self._solver.mask_fbase(True)
        for name in body.joint_names:
            if name not in group.joints:
                self._solver.mask_dof(joint_in_placo(name))
        for name in slides():
            self._solver.mask_dof(name)
        self._gear(group)
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

    def _gear(self, group: Group) -> None:
        """Have joints that mimic one of the group follow it, and the others stay."""
        geared = [follower for follower in self._body.followers if follower.leader_name in group.joints]
        for follower in self._body.followers:
            if follower not in geared:
                self._solver.mask_dof(follower.name)
        if geared:
            gears = self._solver.add_gear_task()
            gears.configure("mimic", "hard")
            for follower in geared:
                gears.set_gear(follower.name, follower.leader, follower.multiplier)

    def descend(self, q: Vector, share: float) -> Vector:
        """Descend from a configuration towards a share of every tolerance."""
        wrapper, columns = self._body.wrapper, self._body.columns
        wrapper.state.q[columns] = q
        self._place_followers(q)
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
            self._place_followers(q)
        return q

    def _place_followers(self, q: Vector) -> None:
        for follower in self._body.followers:
            follower.place(self._body.wrapper, q)

    def _aim(self, q: Vector, share: float) -> float:
        """Set all targets; what is missing to them together [m]."""
        forward = self._body.forward
        forward.place(q)
        missing_m = [task.aim(forward.placement(task.condition.link), share) for task in self._link_tasks]
        missing_m += [task.aim(float(q[task.condition.column]), share) for task in self._joint_tasks]
        return math.hypot(*missing_m)
