"""Kinematics of the robot by pinocchio, without its shapes: link poses, Jacobians, and the reach of its points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.shapes import frame_of_link, kinematic_urdf, outline
from robot.description.model import RobotModel
from robot.description.urdf import Mimic
from robot.trajectory import Vector


class JointMap:
    """Map from the joints of a configuration, ``joint_names`` or all of their own, to pinocchio's, which all move."""

    def __init__(self, robot: RobotModel, model: pin.Model, joint_names: Sequence[str] | None = None) -> None:
        names = [str(name) for name in list(model.names)[1:]]
        own = [name for name in names if robot.joints[name].movable]
        self.joint_names = tuple(own if joint_names is None else joint_names)
        # The position of each of pinocchio's joints is a multiple of one of ours.
        self._matrix = np.zeros((len(names), len(self.joint_names)))
        for row, name in enumerate(names):
            mimic = robot.joints[name].mimic or Mimic(name, 1.0, 0.0)
            self._matrix[row, self.joint_names.index(mimic.joint)] = mimic.multiplier
        self._same = np.array_equal(self._matrix, np.eye(len(names)))

    def positions(self, q: Vector) -> Vector:
        """Return the positions of pinocchio's joints at a configuration."""
        return q if self._same else np.asarray(self._matrix.dot(q))

    def by_joint(self, rows: Vector, *, bounds: bool = False) -> Vector:
        """Return derivatives, or ``bounds`` of them, by a configuration's joints, (..., n), of those by pinocchio's."""
        return np.asarray(rows @ (np.abs(self._matrix) if bounds else self._matrix))


@dataclass(frozen=True)
class Placements:
    """Poses of a link in many configurations."""

    rotations: Vector  # shape (m, 3, 3)
    positions_m: Vector  # shape (m, 3) [m]


class ForwardKinematics:
    """Places the links of one robot; ``joint_names`` are the joints of a configuration ``q``, shape (n,) [rad]."""

    def __init__(self, robot: RobotModel, joint_names: Sequence[str]) -> None:
        self._model = pin.buildModelFromXML(kinematic_urdf(robot))
        self._data = self._model.createData()
        self._joints = JointMap(robot, self._model, joint_names)
        self._frames = {link: frame_of_link(self._model, link) for link in robot.links}

    def place(self, q: Vector) -> None:
        """Move the joints, before :meth:`placement`."""
        pin.forwardKinematics(self._model, self._data, self._joints.positions(q))

    def placement(self, link: str) -> pin.SE3:
        """Return the pose of a link in the root link's frame; it is valid until joints are moved again."""
        return pin.updateFramePlacement(self._model, self._data, self._frames[link])

    def jacobian(self, q: Vector, link: str) -> Vector:
        """Move the joints to ``q``; return a link's Jacobian along the root's axes, linear rows first, (6, n)."""
        pin.computeJointJacobians(self._model, self._data, self._joints.positions(q))
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return self._joints.by_joint(pin.getFrameJacobian(self._model, self._data, self._frames[link], axes))

    def placements(self, configurations: Vector, link: str) -> Placements:
        """Return the pose of a link in each configuration."""
        rotations, positions_m = np.empty((len(configurations), 3, 3)), np.empty((len(configurations), 3))
        for i, q in enumerate(configurations):
            self.place(q)
            placement = self.placement(link)
            rotations[i], positions_m[i] = placement.rotation, placement.translation
        return Placements(rotations, positions_m)


class Reach:
    """Greatest distance of the robot's points from each joint's axis, over all configurations.

    A point is at most as far from the axis of the joint that carries it as it lies there, and from the axis of a joint
    further up as the origins between them are apart, plus all that can swing around the last of them.
    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        self._axes = [_axis(model, joint) if joint else (np.zeros(3), True) for joint in range(model.njoints)]
        self._slides_m = np.zeros(model.njoints)
        for joint in range(1, model.njoints):
            if not self._axes[joint][1]:
                index = model.joints[joint].idx_v
                limits = model.lowerPositionLimit[index], model.upperPositionLimit[index]
                self._slides_m[joint] = max(abs(limits[0]), abs(limits[1]))

    def about_joints(self, joint: int, points: Vector) -> Vector:
        """Bound the travel of points a joint carries, (n, 3) [m], by each joint, (nv,) [m/rad]; 1 if prismatic."""
        reach = np.zeros(self._model.nv)
        swing_m = 0.0
        while joint:
            axis, angular = self._axes[joint]
            across_m = float(np.linalg.norm(np.cross(points, axis), axis=1).max(initial=0.0))
            reach[self._model.joints[joint].idx_v] = across_m + swing_m if angular else 1.0
            swing_m += float(np.linalg.norm(points, axis=1).max(initial=0.0)) + self._slides_m[joint]
            points = self._model.jointPlacements[joint].translation.reshape(1, 3)
            joint = self._model.parents[joint]
        return reach

    def farthest_m(self, shape: pin.GeometryObject) -> float:
        """Upper bound of the distance of a shape's points from the root link's origin [m]."""
        joint, far_m = shape.parentJoint, float(np.linalg.norm(outline(shape), axis=1).max())
        while joint:
            far_m += self._slides_m[joint] + float(np.linalg.norm(self._model.jointPlacements[joint].translation))
            joint = self._model.parents[joint]
        return far_m

    def of_shapes(self, shapes: Sequence[pin.GeometryObject]) -> Vector:
        """Upper bound of the travel of each shape's points, shape (shapes, nv) [m/rad]."""
        resting = np.zeros(self._model.nv)
        reaches = [self.about_joints(s.parentJoint, outline(s)) if s.parentJoint else resting for s in shapes]
        return np.array(reaches).reshape(-1, self._model.nv)

    def of_frames(self) -> Vector:
        """Upper bound of the travel of each frame's origin, shape (frames, nv) [m/rad]."""
        return np.array(
            [self.about_joints(f.parentJoint, f.placement.translation.reshape(1, 3)) for f in self._model.frames]
        )


def approach(reach_m: Vector, pairs: NDArray[np.int64]) -> Vector:
    """Bound how much nearer each pair comes by each joint, (pairs, nv), by the shapes' reach, (shapes, nv) [m/rad]."""
    first, second = reach_m[pairs[:, 0]], reach_m[pairs[:, 1]]
    return np.where((first > 0.0) & (second > 0.0), 0.0, first + second)


def _axis(model: pin.Model, joint: int) -> tuple[Vector, bool]:
    """Axis of a joint in its own frame, and whether the joint turns about it rather than slides along it."""
    kinematics = model.joints[joint]
    data = kinematics.createData()
    kinematics.calc(data, pin.neutral(model))
    subspace = np.asarray(data.S).reshape(6)
    angular = bool(np.linalg.norm(subspace[3:]) > 0.0)
    return (subspace[3:] if angular else subspace[:3]), angular
