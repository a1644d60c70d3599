"""How far any point of the robot can move when its joints move: the yardstick for collision check steps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.shapes import outline

Vector = NDArray[np.float64]


def travel_per_joint(model: pin.Model, geometry: pin.GeometryModel) -> Vector:
    """Upper bound of the travel of any robot point for each joint's motion, whatever the other joints do.

    A point is at most as far from a joint's axis as it lies there on the joint's own shapes, or as the origin of a
    joint it carries plus everything that can swing around that origin.

    Returns:
        Shape (nv,) [m/rad], and 1 for a prismatic joint [m/m].
    """
    swing_m = np.zeros(model.njoints)
    weights = np.zeros(model.nv)
    points = _points_by_joint(model, geometry)
    # Children have higher indices than their parents, so they are done first.
    for joint in range(model.njoints - 1, 0, -1):
        axis, angular = _axis(model, joint)
        index = model.joints[joint].idx_v
        own = points[joint]
        carried = [child for child in range(joint + 1, model.njoints) if model.parents[child] == joint]
        origins = [(model.jointPlacements[child].translation, swing_m[child]) for child in carried]
        swing_m[joint] = _reach(own, origins)
        if angular:
            weights[index] = _reach(_across(own, axis), [(_across(at, axis), swing) for at, swing in origins])
        else:
            weights[index] = 1.0
            limits = model.lowerPositionLimit[index], model.upperPositionLimit[index]
            swing_m[joint] += max(abs(limits[0]), abs(limits[1]))
    return weights


def _reach(points: Vector, origins: list[tuple[Vector, float]]) -> float:
    """Greatest distance from zero of the points and of the spheres around the origins [m]."""
    own = float(np.linalg.norm(points, axis=1).max(initial=0.0))
    return max([own, *(float(np.linalg.norm(at)) + swing for at, swing in origins)])


def _across(points: Vector, axis: Vector) -> Vector:
    """Vectors as long as the points are away from the axis through zero."""
    return np.asarray(np.cross(points, axis), dtype=np.float64)


def _points_by_joint(model: pin.Model, geometry: pin.GeometryModel) -> list[Vector]:
    """Shape (n, 3) [m] for each joint: its shapes' outlines and its frames' origins, in the joint's frame."""
    points: list[list[Vector]] = [[np.zeros((1, 3))] for _ in range(model.njoints)]
    for shape in geometry.geometryObjects:
        points[shape.parentJoint].append(outline(shape))
    for frame in model.frames:
        points[frame.parentJoint].append(frame.placement.translation.reshape(1, 3))
    return [np.vstack(parts) for parts in points]


def _axis(model: pin.Model, joint: int) -> tuple[Vector, bool]:
    """Axis of a joint in its own frame, and whether the joint turns about it rather than slides along it."""
    kinematics = model.joints[joint]
    data = kinematics.createData()
    kinematics.calc(data, pin.neutral(model))
    subspace = np.asarray(data.S).reshape(6)
    angular = bool(np.linalg.norm(subspace[3:]) > 0.0)
    return (subspace[3:] if angular else subspace[:3]), angular
