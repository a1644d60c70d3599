"""An independent judge of motions: the official SO-101 with its full meshes, by pinocchio alone.

It shares no code with the planners: it reads problem files and answers as JSON has them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Fields = Mapping[str, Any]

# Greatest radius of any point of the official meshes about each axis, jaw open, and 6 cm for what is held.
TRAVEL_M_PER_RAD = {
    "shoulder_pan": 0.51,
    "shoulder_lift": 0.48,
    "elbow_flex": 0.37,
    "wrist_flex": 0.23,
    "wrist_roll": 0.17,
}

# No point of the arm moves further between two checks.
STEP_M = 0.001

# Rates are taken from positions this far apart: short beside the shortest phase of a motion, long beside rounding.
DIFFERENCE_S = 0.0005

# Rates may exceed their limits by the rounding of the differences only.
RATE_EXCESS = 1e-3

# A servo's smallest speed is 50 times this.
REST_RAD_S = 3e-5

# Problem files have six digits.
POSITION_TOLERANCE_RAD = 2e-6

# Less than the resolution of any measurement of a tip.
TIP_TOLERANCE_M = 1e-5

BASE = "base_link"
TIP = "gripper_frame_link"


class Judge:
    """The official arm among the things of one problem file, read from JSON, with the folder of reference data."""

    def __init__(self, shared: Path, fields: Fields) -> None:
        self._model, official = official_arm(shared / "so101" / "so101_new_calib.urdf")
        self._data = self._model.createData()
        self._geometry = official.copy()
        self._limits = {key: np.asarray(values) for key, values in fields["limits"].items()}
        self._names: Sequence[str] = fields["joint_names"]
        joints = list(self._model.names)[1:]
        self._columns = [joints.index(name) for name in self._names]
        self._q = np.zeros(len(joints))
        self._q[joints.index("gripper")] = fields.get("gripper", 0.0)
        self._travel_m_per_rad = np.array([TRAVEL_M_PER_RAD[name] for name in self._names])
        never = json.loads((shared / "so101_disabled_collisions.json").read_text())["pairs_never_colliding"]
        self._add_pairs(fields, {frozenset(pair) for pair in never})
        self._geometry_data = self._geometry.createData()
        self._tree = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._model, self._geometry, self._geometry_data
        )

    def collides(self, point: Vector) -> bool:
        """Return true if anything touches in a configuration of the file's joints, shape (n,) [rad]."""
        self._q[self._columns] = point
        return bool(pin.computeCollisions(self._model, self._data, self._tree, self._q, True))

    def tip_m(self, point: Vector) -> Vector:
        """Return the position of the tip in a configuration [m]."""
        self._q[self._columns] = point
        pin.framesForwardKinematics(self._model, self._data, self._q)
        position_m: Vector = self._data.oMf[self._model.getFrameId(TIP)].translation.copy()
        return position_m

    def faults(self, asked: Fields, answer: Fields, rate_excess: float = RATE_EXCESS) -> list[str]:
        """Return the faults of what ``armbridge plan --json`` writes of a problem; rates have an excess [share]."""
        times_s, positions, velocities, accelerations = (
            np.asarray(answer[key], dtype=np.float64)
            for key in ("time_from_start", "positions", "velocities", "accelerations")
        )
        if not all(np.all(np.isfinite(part)) for part in (times_s, positions, velocities, accelerations)):
            return ["numbers that are not finite"]
        if times_s[0] != 0.0 or np.any(np.diff(times_s) <= 0.0):
            return ["times that do not increase from 0"]
        curve = _Curve(times_s, positions, velocities)
        return [
            *self._faults_of_ends(asked, positions, velocities),
            *self._faults_of_limits(curve, accelerations, 1.0 + rate_excess),
            *self._faults_of_contact(curve),
        ]

    def _faults_of_ends(self, asked: Fields, positions: Vector, velocities: Vector) -> Iterator[str]:
        if np.max(np.abs(positions[0] - np.asarray(asked["start"]))) > POSITION_TOLERANCE_RAD:
            yield "does not start at the start"
        if "goal" in asked and np.max(np.abs(positions[-1] - np.asarray(asked["goal"]))) > POSITION_TOLERANCE_RAD:
            yield "does not end in the goal"
        if "position" in asked:
            distance_m = np.linalg.norm(self.tip_m(positions[-1]) - np.asarray(asked["position"]))
            if distance_m > asked["tolerance"] + TIP_TOLERANCE_M:
                yield f"ends {1000.0 * distance_m:.1f} mm from the goal"
        if np.max(np.abs(velocities[[0, -1]])) > REST_RAD_S:
            yield "does not start and end at rest"

    def _faults_of_limits(self, curve: _Curve, accelerations: Vector, most: float) -> Iterator[str]:
        lower, upper, velocity, acceleration = (
            self._limits[key] for key in ("lower", "upper", "velocity", "acceleration")
        )
        if curve.duration_s == 0.0:
            return
        positions = curve(np.arange(0.0, curve.duration_s, DIFFERENCE_S))
        beyond = max(np.max(lower - positions), np.max(positions - upper))
        if beyond > POSITION_TOLERANCE_RAD:
            yield f"beyond a position limit by {beyond:.2g} rad"
        rates = np.diff(positions, axis=0) / DIFFERENCE_S
        excess = np.max(np.abs(rates) / velocity, initial=0.0)
        if excess > most:
            yield f"{excess:.4f} times a velocity limit"
        changes = np.diff(rates, axis=0) / DIFFERENCE_S
        excess = max(np.max(np.abs(part) / acceleration, initial=0.0) for part in (changes, accelerations))
        if excess > most:
            yield f"{excess:.4f} times an acceleration limit"

    def _faults_of_contact(self, curve: _Curve) -> Iterator[str]:
        times_s = self._check_times_s(curve)
        for time_s, point in zip(times_s, curve(times_s), strict=True):
            if self.collides(point):
                yield f"touches at {time_s:.3f} s: {', '.join(self._touching(point))}"
                return

    def _check_times_s(self, curve: _Curve) -> Vector:
        """Times between which no point of the arm moves more than :data:`STEP_M`."""
        times_s = np.linspace(0.0, curve.duration_s, 2 + int(curve.duration_s / DIFFERENCE_S))
        moved_m = np.abs(np.diff(curve(times_s), axis=0)) @ self._travel_m_per_rad
        travel_m = np.concatenate(([0.0], np.cumsum(moved_m)))
        return np.interp(np.linspace(0.0, travel_m[-1], 2 + int(travel_m[-1] / STEP_M)), travel_m, times_s)

    def _touching(self, point: Vector) -> list[str]:
        self._q[self._columns] = point
        pin.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, self._q, False)
        shapes = self._geometry.geometryObjects
        return [
            f"{shapes[pair.first].name} and {shapes[pair.second].name}"
            for pair, result in zip(self._geometry.collisionPairs, self._geometry_data.collisionResults, strict=True)
            if result.isCollision()
        ]

    def _add_pairs(self, fields: Fields, never: set[frozenset[str]]) -> None:
        """Links with links, things with moving links, and held things with all but what holds and may touch them."""
        links = [(i, self._link(shape)) for i, shape in enumerate(self._geometry.geometryObjects)]
        adjacent = {
            frozenset((self._link_of_joint(i), self._link_of_joint(self._model.parents[i])))
            for i in range(1, self._model.njoints)
        }
        for (i, first), (j, second) in combinations(links, 2):
            if first != second and frozenset((first, second)) not in adjacent | never:
                self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        held = [(self._add(thing, thing["link"]), thing) for thing in fields["attached"]]
        for i, thing in held:
            exempt = {*thing.get("touch_links", ()), self._holder(thing["link"])}
            self._add_each(i, [j for j, link in links if link not in exempt])
        for thing in fields["objects"]:
            i = self._add(thing, "universe")
            self._add_each(i, [j for j, link in links if link != BASE] + [j for j, _ in held])

    def _add_each(self, i: int, others: Sequence[int]) -> None:
        for j in others:
            self._geometry.addCollisionPair(pin.CollisionPair(j, i))

    def _add(self, thing: Fields, frame_name: str) -> int:
        """Put a thing into a frame; the index of its shape."""
        frame_id = self._model.getFrameId(frame_name)
        frame = self._model.frames[frame_id]
        pose = pin.XYZQUATToSE3(np.array([*thing["pose"]["position"], *thing["pose"]["orientation"]], dtype=np.float64))
        shape = pin.GeometryObject(thing["id"], frame.parentJoint, frame_id, frame.placement * pose, _coal_shape(thing))
        return int(self._geometry.addGeometryObject(shape))

    def _link(self, shape: pin.GeometryObject) -> str:
        return str(self._model.frames[shape.parentFrame].name)

    def _holder(self, link: str) -> str:
        """The link with meshes that a frame is fixed to."""
        return self._link_of_joint(self._model.frames[self._model.getFrameId(link)].parentJoint)

    def _link_of_joint(self, joint: int) -> str:
        """The link with meshes that a joint moves."""
        return next(self._link(shape) for shape in self._geometry.geometryObjects if shape.parentJoint == joint)


class _Curve:
    """Cubic Hermite interpolation of samples."""

    def __init__(self, times_s: Vector, positions: Vector, velocities: Vector) -> None:
        self._times_s, self._positions, self._velocities = times_s, positions, velocities
        self.duration_s = float(times_s[-1])

    def __call__(self, at_s: Vector) -> Vector:
        """Positions, shape (m, n)."""
        if len(self._times_s) == 1:
            return np.repeat(self._positions, len(at_s), axis=0)
        i = np.clip(np.searchsorted(self._times_s, at_s, side="right") - 1, 0, len(self._times_s) - 2)
        span_s = (self._times_s[i + 1] - self._times_s[i])[:, np.newaxis]
        u = (at_s - self._times_s[i])[:, np.newaxis] / span_s
        result: Vector = (
            (1.0 + 2.0 * u) * (1.0 - u) ** 2 * self._positions[i]
            + u * (1.0 - u) ** 2 * span_s * self._velocities[i]
            + u**2 * (3.0 - 2.0 * u) * self._positions[i + 1]
            + u**2 * (u - 1.0) * span_s * self._velocities[i + 1]
        )
        return result


@cache
def official_arm(urdf: Path) -> tuple[pin.Model, pin.GeometryModel]:
    """Loading takes two seconds and 300 MB, so it is done once."""
    model = pin.buildModelFromUrdf(str(urdf))
    geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=[str(urdf.parent)])
    return model, geometry


def _coal_shape(thing: Fields) -> coal.CollisionGeometry:
    size = thing.get("dimensions", [])
    match thing["type"]:
        case "box":
            return coal.Box(*size)
        case "sphere":
            return coal.Sphere(*size)
        case "cylinder":
            return coal.Cylinder(size[1], size[0])
        case "cone":
            return coal.Cone(size[1], size[0])
        case "mesh":
            mesh = coal.BVHModelOBBRSS()
            mesh.beginModel(len(thing["triangles"]), len(thing["vertices"]))
            mesh.addVertices(np.asarray(thing["vertices"], dtype=np.float64))
            mesh.addTriangles(np.asarray(thing["triangles"], dtype=np.int64))
            mesh.endModel()
            return mesh
    raise ValueError(f"a thing of the unknown type {thing['type']!r}")
