"""Inverse kinematics by placo: from a configuration to one nearby where conditions hold, as tasks of its solver."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import placo

from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import frame_of_link, kinematic_urdf
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
from robot.trajectory import Vector

# Further ahead than this the arm is not nearly linear, and a target far outside would throw it into its limits.
MAX_STEP_M = 0.1
MAX_STEP_RAD = 0.7

# A condition that holds would keep its link in place while another one pulls: it has this share of its weight until it
# is broken.
RELAXED = 1e-3

MAX_POINTS = 4  # conditions on points that one descent can have

# Weight of the present configuration against 1 for the conditions. Far from the target it must be felt: joints that
# barely move the tip would otherwise be driven into their limits. Near to it, it would only slow the descent down: so
# it shrinks with the square of the error, after Levenberg and Marquardt.
REGULARIZATION_PER_M2 = 1.0
LEAST_REGULARIZATION = 1e-7
MOST_REGULARIZATION = 1e-3

MAX_STEPS = 60  # convergence takes 5-10 steps within reach and up to 40 at its edge

# A descent that has not come nearer by this share within a number of steps has arrived at its nearest point.
LEAST_GAIN = 0.005
PATIENCE = 5

ACCURACY_M = 1e-4  # below the servos' 1.5 mrad, however wide the goal's tolerance

# Weight of preferred conditions against 1 for required ones; a second descent without them makes up for their cost.
PREFERENCE = 0.01

# Shares of a tolerance that descents aim at: its middle, or, where that is out of reach, a little inside its edge.
MIDDLE = 0.0
INNER_SHARE = 0.9


class Kinematics:
    """placo's model of one robot; ``joint_names`` are the joints of a configuration ``q``, shape (n,) [rad]."""

    def __init__(self, robot: RobotModel, forward: ForwardKinematics, joint_names: Sequence[str]) -> None:
        # placo leaks some 0.16 MB per wrapper, so there is one for life.
        self.wrapper = placo.RobotWrapper("", placo.Flags.ignore_collisions, with_point_frames(robot))
        self.forward = forward
        self.joint_names = joint_names
        self.mimics = [(joint_in_placo(name), joint.mimic) for name, joint in robot.joints.items() if joint.mimic]
        self._columns = np.array([self.wrapper.get_joint_offset(joint_in_placo(name)) for name in joint_names])
        self._lower_rad = np.array([robot.joints[name].lower for name in joint_names])
        self._upper_rad = np.array([robot.joints[name].upper for name in joint_names])

    def place(self, q: Vector) -> None:
        """Move the joints, and those that mimic them."""
        self.wrapper.state.q[self._columns] = q
        for name, mimic in self.mimics:
            position = mimic.multiplier * q[self.joint_names.index(mimic.joint)]
            self.wrapper.state.q[self.wrapper.get_joint_offset(name)] = position
        self.forward.place(q)

    def advance(self, solver: placo.KinematicsSolver) -> Vector:
        """Take one step of a solver from the present configuration; return the next one."""
        self.wrapper.update_kinematics()
        solver.solve(True)
        # The solver keeps limits to its own accuracy only.
        return np.asarray(np.minimum(np.maximum(self.wrapper.state.q[self._columns], self._lower_rad), self._upper_rad))


class _Task(ABC):
    """Task of placo's solver that moves the arm until a condition holds."""

    def __init__(self, solver: _Solver, condition: Condition, weight: float, task: placo.Task, name: str) -> None:
        self.condition = condition
        self._forward = solver.kinematics.forward
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

    def aim(self, q: Vector, share: float) -> float:  # noqa: ARG002 - the links have been placed there
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

    def __init__(self, solver: _Solver, condition: PointCondition, weight: float, index: int) -> None:
        name = _point_frame(index)
        self._position_task = solver.placo.add_position_task(name, np.zeros(3))
        super().__init__(solver, condition, weight, self._position_task, name)
        self._model = solver.kinematics.wrapper.model
        self._frame = frame_of_link(self._model, name)
        carrier = self._model.frames[frame_of_link(self._model, condition.link)]
        self._joint, self._place = carrier.parentJoint, carrier.placement * pin.SE3(np.eye(3), condition.offset_m)

    def attach(self) -> None:
        """Place the frame on the link: other descents use the same one."""
        frame = self._model.frames[self._frame]
        frame.parentJoint, frame.placement = self._joint, self._place

    def _set_target(self, placement: pin.SE3, step: Vector) -> None:
        self._position_task.target_world = self.condition.point(placement) + self.condition.axes @ step


class _TurnTask(_LinkTask):
    """Turns a link, or an axis of it and not about that axis: placo's task for axes divides by zero at its goal."""

    def __init__(self, solver: _Solver, condition: TurnCondition | AxisCondition, weight: float, index: int) -> None:
        self._orientation_task = solver.placo.add_orientation_task(condition.link, np.eye(3))
        super().__init__(solver, condition, weight, self._orientation_task, f"turn {index}")
        self._across = frame_along(condition.axis) if isinstance(condition, AxisCondition) else None
        if self._across is not None:
            self._orientation_task.mask.set_axises("xy", "custom")

    def _set_target(self, placement: pin.SE3, step: Vector) -> None:
        self._orientation_task.R_world_frame = placement.rotation @ pin.exp3(step)
        if self._across is not None:
            self._orientation_task.mask.R_custom_world = (placement.rotation @ self._across).T


class _JointTask(_Task):
    """Moves a joint into its range."""

    condition: JointCondition

    def __init__(self, solver: _Solver, condition: JointCondition, weight: float, index: int) -> None:
        self._joints_task = solver.placo.add_joints_task()
        super().__init__(solver, condition, weight, self._joints_task, f"joint {index}")

    def aim(self, q: Vector, share: float) -> float:
        position_rad = float(q[self.condition.column])
        violation_rad = self.condition.violation_rad(position_rad, share)
        self._joints_task.set_joint(joint_in_placo(self.condition.joint), position_rad + violation_rad)
        return self._weighted(abs(violation_rad))


def _task(solver: _Solver, condition: Condition, weight: float, index: int) -> _Task:
    match condition:
        case JointCondition():
            return _JointTask(solver, condition, weight, index)
        case PointCondition():
            return _PointTask(solver, condition, weight, index)
        case TurnCondition() | AxisCondition():
            return _TurnTask(solver, condition, weight, index)


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


class Descent:
    """Descent to nearby configurations within limits where conditions hold, or nearly; only the group moves."""

    def __init__(self, kinematics: Kinematics, group: Group, goal_conditions: GoalConditions) -> None:
        required = [(condition, condition.weight) for condition in goal_conditions.required]
        preferred = [(condition, PREFERENCE * condition.weight) for condition in goal_conditions.preferred]
        self._required = _Solver(kinematics, group, required)
        self._both = _Solver(kinematics, group, [*required, *preferred]) if preferred else None
        self._holds = ConditionSet(kinematics.forward, goal_conditions.required).holds

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

    def __init__(self, kinematics: Kinematics, group: Group, weighted: Sequence[tuple[Condition, float]]) -> None:
        self.kinematics = kinematics
        self.placo = kinematics.wrapper.make_solver()
        # Otherwise the base flies to the target.
        self.placo.mask_fbase(True)
        for name in kinematics.joint_names:
            if name not in group.joints:
                self.placo.mask_dof(joint_in_placo(name))
        self._couple_mimics(group.joints)
        self.placo.enable_joint_limits(True)
        self._regularization = self.placo.add_regularization_task(MOST_REGULARIZATION)
        # Conditions on points come first: there are frames for the first few tasks only.
        weighted = sorted(weighted, key=lambda pair: not isinstance(pair[0], PointCondition))
        self._tasks = [_task(self, condition, weight, index) for index, (condition, weight) in enumerate(weighted)]

    def _couple_mimics(self, moving: Sequence[str]) -> None:
        """Have joints that mimic a moving one follow it, and the others stay."""
        coupled = [(name, mimic) for name, mimic in self.kinematics.mimics if mimic.joint in moving]
        for name, mimic in self.kinematics.mimics:
            if mimic.joint not in moving:
                self.placo.mask_dof(name)
        if coupled:
            gears = self.placo.add_gear_task()
            gears.configure("mimic", "hard")
            for name, mimic in coupled:
                gears.set_gear(name, joint_in_placo(mimic.joint), mimic.multiplier)

    def descend(self, q: Vector, share: float) -> Vector:
        for task in self._tasks:
            if isinstance(task, _PointTask):
                task.attach()
        least_m, idle = math.inf, 0
        for _ in range(MAX_STEPS):
            self.kinematics.place(q)
            distance_m = math.hypot(*(task.aim(q, share) for task in self._tasks))
            idle = idle + 1 if distance_m > (1.0 - LEAST_GAIN) * least_m else 0
            if distance_m < ACCURACY_M or idle > PATIENCE:
                break
            least_m = min(least_m, distance_m)
            weight = REGULARIZATION_PER_M2 * distance_m**2
            self._regularization.set_weight(min(MOST_REGULARIZATION, max(LEAST_REGULARIZATION, weight)))
            q = self.kinematics.advance(self.placo)
        return q
