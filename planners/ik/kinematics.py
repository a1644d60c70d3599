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
from planners.geometry.shapes import frame_of_link
from planners.ik.constraints import (
    AxisCondition,
    Condition,
    ConditionSet,
    GoalConditions,
    JointCondition,
    LinkCondition,
    PointCondition,
    frame_along,
    norm,
)
from robot.description.model import Group, RobotModel
from robot.description.urdf import Mimic
from robot.trajectory import Vector

# Further ahead than this the arm is not nearly linear, and a target far outside would throw it into its limits.
MAX_STEP_M = 0.1
MAX_STEP_RAD = 0.7

# A condition that holds would keep its link in place while another one pulls: it has this share of its weight until it
# is broken.
RELAXED = 1e-3

# Conditions on points that one goal can have.
MAX_POINTS = 4

# Weight of the present configuration against 1 for the conditions. Far from the target it must be felt: joints that
# barely move the tip would otherwise be driven into their limits. Near to it, it would only slow the descent down: so
# it shrinks with the square of the error, after Levenberg and Marquardt.
REGULARIZATION_PER_M2 = 1.0
LEAST_REGULARIZATION = 1e-7
MOST_REGULARIZATION = 1e-3

# Convergence takes 5-10 steps within reach and up to 40 at its edge.
MAX_STEPS = 60

# A descent that has not come nearer by this share in so many steps has arrived at its nearest point.
LEAST_GAIN = 0.005
PATIENCE = 5

# Below the servos' 1.5 mrad, however wide the goal's tolerance.
ACCURACY_M = 1e-4

# Weight of preferred conditions against 1 for required ones; a second descent without them makes up for their cost.
PREFERENCE = 0.01

# Shares of a tolerance that descents aim at: its middle, or, where that is out of reach, a little inside its edge.
MIDDLE = 0.0
INNER_SHARE = 0.9


@dataclass(frozen=True)
class _PlacoModel:
    """placo's model of the robot, and the places of a configuration's joints in it."""

    wrapper: placo.RobotWrapper
    forward: ForwardKinematics
    joint_names: Sequence[str]
    columns: NDArray[np.int64]
    mimics: Sequence[_MimicJoint]
    lower_rad: Vector
    upper_rad: Vector

    def set_configuration(self, q: Vector) -> None:
        """Move the joints, and those that mimic them."""
        self.wrapper.state.q[self.columns] = q
        for joint in self.mimics:
            self.wrapper.state.q[joint.column] = joint.multiplier * q[joint.leader_column]


@dataclass(frozen=True)
class _MimicJoint:
    """Joint that mimics another one, by names and places in placo's model."""

    name: str
    leader: str
    multiplier: float
    column: int
    leader_column: int


class _Task(ABC):
    """Task of placo's solver that moves the arm until a condition holds."""

    def __init__(self, condition: Condition, weight: float, task: placo.Task, name: str) -> None:
        self.condition = condition
        self._scale = condition.arm_m * math.sqrt(weight)
        self._task, self._name = task, name
        self._relaxed: bool | None = None

    @abstractmethod
    def aim(self, q: Vector, share: float) -> float:
        """Set the next target, towards a share of the tolerance; return the weighted distance from there [m]."""

    def _weighted(self, distance: float) -> float:
        """Return a weighted distance [m], and have a task whose condition holds give way to others."""
        relaxed = distance == 0.0
        if relaxed is not self._relaxed:
            self._relaxed = relaxed
            self._task.configure(self._name, "soft", self._scale**2 * (RELAXED if relaxed else 1.0))
        return self._scale * distance


class _LinkTask(_Task):
    """Moves a link."""

    condition: LinkCondition
    max_step = MAX_STEP_RAD

    def __init__(
        self, forward: ForwardKinematics, condition: LinkCondition, weight: float, task: placo.Task, name: str
    ) -> None:
        super().__init__(condition, weight, task, name)
        self._forward = forward

    def aim(self, q: Vector, share: float) -> float:  # noqa: ARG002 - the links have been placed there
        """Aim a step ahead at most."""
        placement = self._forward.placement(self.condition.link)
        violation = self.condition.violation(self.condition.error(placement), share)
        length = norm(violation)
        self._set_target(placement, violation * min(1.0, self.max_step / max(length, self.max_step)))
        return self._weighted(length)

    @abstractmethod
    def _set_target(self, placement: pin.SE3, step: Vector) -> None:
        """Set the target a step away from a placement, along the axes of the condition's error."""


class _PointTask(_LinkTask):
    """Moves a point of a link: the origin of one of the model's point frames, which is attached to the link."""

    condition: PointCondition
    max_step = MAX_STEP_M

    def __init__(
        self, body: _PlacoModel, solver: placo.KinematicsSolver, condition: PointCondition, weight: float, index: int
    ) -> None:
        name = _point_frame(index)
        self._position_task = solver.add_position_task(name, np.zeros(3))
        super().__init__(body.forward, condition, weight, self._position_task, name)
        self._model = body.wrapper.model
        self._frame = frame_of_link(self._model, name)

    def attach(self) -> None:
        """Place the frame on the link: other descents use the same one."""
        carrier = self._model.frames[frame_of_link(self._model, self.condition.link)]
        frame = self._model.frames[self._frame]
        frame.parentJoint = carrier.parentJoint
        frame.placement = carrier.placement * pin.SE3(np.eye(3), self.condition.offset_m)

    def _set_target(self, placement: pin.SE3, step: Vector) -> None:
        self._position_task.target_world = self.condition.point(placement) + self.condition.axes @ step


class _TurnTask(_LinkTask):
    """Turns a link."""

    def __init__(
        self, body: _PlacoModel, solver: placo.KinematicsSolver, condition: LinkCondition, weight: float, index: int
    ) -> None:
        self._orientation_task = solver.add_orientation_task(condition.link, np.eye(3))
        super().__init__(body.forward, condition, weight, self._orientation_task, f"turn {index}")

    def _set_target(self, placement: pin.SE3, step: Vector) -> None:
        self._orientation_task.R_world_frame = placement.rotation @ pin.exp3(step)


class _AxisTask(_TurnTask):
    """Turns an axis of a link and leaves the turn about it free: placo's own such task divides by zero at its goal."""

    condition: AxisCondition

    def __init__(
        self, body: _PlacoModel, solver: placo.KinematicsSolver, condition: AxisCondition, weight: float, index: int
    ) -> None:
        super().__init__(body, solver, condition, weight, index)
        self._across = frame_along(condition.axis)
        self._orientation_task.mask.set_axises("xy", "custom")

    def _set_target(self, placement: pin.SE3, step: Vector) -> None:
        super()._set_target(placement, step)
        self._orientation_task.mask.R_custom_world = (placement.rotation @ self._across).T


class _JointTask(_Task):
    """Moves a joint into its range."""

    condition: JointCondition

    def __init__(self, solver: placo.KinematicsSolver, condition: JointCondition, weight: float, index: int) -> None:
        self._joints_task = solver.add_joints_task()
        super().__init__(condition, weight, self._joints_task, f"joint {index}")

    def aim(self, q: Vector, share: float) -> float:
        """Aim into the range."""
        position_rad = float(q[self.condition.column])
        violation_rad = self.condition.violation_rad(position_rad, share)
        self._joints_task.set_joint(joint_in_placo(self.condition.joint), position_rad + violation_rad)
        return self._weighted(abs(violation_rad))


def _task(body: _PlacoModel, solver: placo.KinematicsSolver, condition: Condition, weight: float, index: int) -> _Task:
    match condition:
        case JointCondition():
            return _JointTask(solver, condition, weight, index)
        case PointCondition():
            return _PointTask(body, solver, condition, weight, index)
        case AxisCondition():
            return _AxisTask(body, solver, condition, weight, index)
        case _:
            return _TurnTask(body, solver, condition, weight, index)


def with_point_frames(robot: RobotModel) -> str:
    """Return the URDF text of a robot's kinematics with frames that can be attached to points of its links."""
    root = ET.fromstring(kinematic_urdf(robot))  # noqa: S314 - made from what robot.description.model has parsed
    for joint in root.iterfind("joint"):
        joint.set("name", joint_in_placo(joint.get("name", "")))
    for index in range(MAX_POINTS):
        ET.SubElement(root, "link", name=_point_frame(index))
        joint = ET.SubElement(root, "joint", name=joint_in_placo(_point_frame(index)), type="fixed")
        ET.SubElement(joint, "parent", link=robot.root_link)
        ET.SubElement(joint, "child", link=_point_frame(index))
    return ET.tostring(root, encoding="unicode")


def joint_in_placo(name: str) -> str:
    """Return the name of a joint in placo's model, which must differ from every link's."""
    return f"joint {name}"


def _point_frame(index: int) -> str:
    return f"planning point {index}"


class Kinematics:
    """Inverse kinematics of one robot.

    Args:
        robot: the arm.
        forward: places its links.
        joint_names: joints of a configuration ``q``, shape (n,) [rad].
    """

    def __init__(self, robot: RobotModel, forward: ForwardKinematics, joint_names: Sequence[str]) -> None:
        # placo leaks some 0.16 MB per wrapper, so there is one for life.
        wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, with_point_frames(robot))

        def mimic_joint(name: str, mimic: Mimic) -> _MimicJoint:
            in_placo, leader = joint_in_placo(name), joint_in_placo(mimic.joint)
            column, leader_column = wrapper.get_joint_offset(in_placo), joint_names.index(mimic.joint)
            return _MimicJoint(in_placo, leader, mimic.multiplier, column, leader_column)

        self._body = _PlacoModel(
            wrapper,
            forward,
            joint_names,
            np.array([wrapper.get_joint_offset(joint_in_placo(name)) for name in joint_names]),
            [mimic_joint(name, joint.mimic) for name, joint in robot.joints.items() if joint.mimic],
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
        required = [(condition, condition.weight) for condition in goal_conditions.required]
        preferred = [(condition, PREFERENCE * condition.weight) for condition in goal_conditions.preferred]
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
    """Minimizes the violation of conditions, each with its weight."""

    def __init__(self, body: _PlacoModel, group: Group, weighted: Sequence[tuple[Condition, float]]) -> None:
        self._body = body
        self._solver = body.wrapper.make_solver()
        # Otherwise the base flies to the target.
        self._solver.mask_fbase(True)
        for name in body.joint_names:
            if name not in group.joints:
                self._solver.mask_dof(joint_in_placo(name))
        self._couple_mimics([joint_in_placo(name) for name in group.joints])
        self._solver.enable_joint_limits(True)
        self._regularization = self._solver.add_regularization_task(MOST_REGULARIZATION)
        # Conditions on points come first: there are frames for the first few tasks only.
        weighted = sorted(weighted, key=lambda pair: not isinstance(pair[0], PointCondition))
        self._tasks = [
            _task(body, self._solver, condition, weight, index) for index, (condition, weight) in enumerate(weighted)
        ]

    def _couple_mimics(self, moving: Sequence[str]) -> None:
        """Have joints that mimic a moving one follow it, and the others stay."""
        coupled = [joint for joint in self._body.mimics if joint.leader in moving]
        for joint in self._body.mimics:
            if joint not in coupled:
                self._solver.mask_dof(joint.name)
        if coupled:
            gears = self._solver.add_gear_task()
            gears.configure("mimic", "hard")
            for joint in coupled:
                gears.set_gear(joint.name, joint.leader, joint.multiplier)

    def descend(self, q: Vector, share: float) -> Vector:
        """Descend from a configuration towards a share of every tolerance."""
        body = self._body
        for task in self._tasks:
            if isinstance(task, _PointTask):
                task.attach()
        body.set_configuration(q)
        least_m, idle = math.inf, 0
        for _ in range(MAX_STEPS):
            body.forward.place(q)
            distance_m = math.hypot(*(task.aim(q, share) for task in self._tasks))
            idle = idle + 1 if distance_m > (1.0 - LEAST_GAIN) * least_m else 0
            if distance_m < ACCURACY_M or idle > PATIENCE:
                break
            least_m = min(least_m, distance_m)
            weight = REGULARIZATION_PER_M2 * distance_m**2
            self._regularization.set_weight(min(MOST_REGULARIZATION, max(LEAST_REGULARIZATION, weight)))
            body.wrapper.update_kinematics()
            self._solver.solve(True)
            # The solver keeps limits to its own accuracy only.
            q = np.minimum(np.maximum(body.wrapper.state.q[body.columns], body.lower_rad), body.upper_rad)
            body.set_configuration(q)
        return q
