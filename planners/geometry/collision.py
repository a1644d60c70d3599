"""Collision model of the robot and its scene: checked pairs, contacts and distances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.contacts import (
    MESH_EXCUSE_M,
    MESH_MARGIN_M,
    Broadphase,
    ExactShapes,
    Parts,
    deeper_than,
    encloses,
    nearer_than,
    nearest,
    overlap_m,
    parts_of,
)
from planners.geometry.kinematics import JointMap, Reach, approach
from planners.geometry.nearness import Nearest, NearPair
from planners.geometry.plain_urdf import kinematic_urdf
from planners.geometry.shapes import frame_of_link, link_name, placement, robot_shapes, scaled, solid, urdf_shapes
from planners.goals import ZERO
from planners.problem import PlanningFailure
from planners.scene import EMPTY_SCENE, AttachedObject, Point, Scene
from planners.scene_checks import check_scene
from robot.description.model import RobotModel
from robot.trajectory import Vector

# Depths of the same contact differ by this much between runs of the penetration algorithm.
DEPTH_ACCURACY_M = 0.0002

# By so much a hull reaches beyond what it encloses.
HULL_EXCESS_M = 0.02

NO_CONTACT: Mapping[frozenset[str], float] = {}


class Closeness(IntEnum):
    """How closely a pair of names is checked beyond its hulls."""

    PARTS = 1
    SURFACES = 2


# Pairs of names that are checked by closer shapes than their hulls.
Closer = Mapping[frozenset[str], Closeness]
NONE_CLOSER: Closer = {}


@dataclass(frozen=True)
class Body:
    """One shape of a link or an object.

    Attributes:
        name: of the link or the object.
        shape: where it is and what carries it.
        is_link: whether it belongs to the robot itself.
        meets_links: whether it is checked against links.
        meets_objects: whether it is checked against objects.
        may_touch: names of links that it may touch.
        padding_m: how much thicker it is when it meets objects [m].
    """

    name: str
    shape: pin.GeometryObject
    is_link: bool
    meets_links: bool = True
    meets_objects: bool = True
    may_touch: frozenset[str] = frozenset()
    padding_m: float = 0.0


def link_bodies(model: pin.Model, shapes: Sequence[pin.GeometryObject], scene: Scene) -> list[Body]:
    """Return the bodies of the robot's links, padded and scaled as in a scene.

    Returns:
        One body for each shape; after them one for each scaled shape: only objects meet links in their other size.
    """
    bodies, larger = [], []
    for shape in shapes:
        name = link_name(model, shape)
        padding_m, factor = scene.link_padding_m.get(name, 0.0), scene.link_scale.get(name, 1.0)
        as_is = factor == 1.0
        bodies.append(Body(name, shape, is_link=True, meets_objects=as_is, padding_m=padding_m))
        if not as_is:
            resized = pin.GeometryObject(
                shape.name, shape.parentJoint, shape.parentFrame, shape.placement, scaled(shape.geometry, factor)
            )
            larger.append(Body(name, resized, is_link=True, meets_links=False, padding_m=padding_m))
    return [*bodies, *larger]


def attached_bodies(model: pin.Model, attached: AttachedObject, reach_m: float) -> Iterator[Body]:
    """Yield the bodies of an attached object, which may touch its link.

    Args:
        model: the robot's joints.
        attached: the object.
        reach_m: points further than this from the robot can be left out of a plane [m].
    """
    frame_id = frame_of_link(model, attached.link)
    frame = model.frames[frame_id]
    touched = attached.touch_links | {attached.link}
    at_link = frame.placement * placement(attached.object.pose)
    for shape, pose in attached.object.shapes:
        geometry, local = solid(shape, reach_m)
        place = at_link * placement(pose) * local
        carried = pin.GeometryObject(attached.object.name, frame.parentJoint, frame_id, place, geometry)
        yield Body(attached.object.name, carried, is_link=False, may_touch=touched)


def object_bodies(scene: Scene, reach_m: float) -> Iterator[Body]:
    """Yield the bodies of the objects around the robot."""
    for scene_object in scene.objects:
        pose = placement(scene_object.pose)
        for shape, at in scene_object.shapes:
            place = pose * placement(at)
            geometry, local = solid(shape, reach_m + math.hypot(*place.translation))
            carried = pin.GeometryObject(scene_object.name, 0, 0, place * local, geometry)
            yield Body(scene_object.name, carried, is_link=False)


class PairFilter:
    """Pairs of bodies that are checked against each other.

    Those that do not move against each other are not, be they links of one joint or the root link and the world.

    Args:
        robot: neighbours and the pairs that its SRDF disables are not checked.
        allowed: pair of names -> whether it may touch, whatever the SRDF says.
    """

    def __init__(self, robot: RobotModel, allowed: Mapping[frozenset[str], bool]) -> None:
        adjacent = {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}
        self._unchecked = {names for names in adjacent | robot.disabled_pairs if allowed.get(names, True)}
        self._unchecked |= {names for names, may_touch in allowed.items() if may_touch}

    def pairs(self, movers: Sequence[Body], resting: Sequence[Body]) -> NDArray[np.int64]:
        """Return the indices of bodies to check, ``movers`` and then ``resting``, shape (pairs, 2), smaller first."""
        bodies = [*movers, *resting]
        found = [
            (i, j)
            for i, first in enumerate(movers)
            for j, second in enumerate(bodies[i + 1 :], i + 1)
            if self._checked(first, second)
        ]
        return np.array(found, dtype=np.int64).reshape(-1, 2)

    def _checked(self, first: Body, second: Body) -> bool:
        return (
            first.shape.parentJoint != second.shape.parentJoint
            and (first.meets_links if second.is_link else first.meets_objects)
            and (second.meets_links if first.is_link else second.meets_objects)
            and first.name not in second.may_touch
            and second.name not in first.may_touch
            and frozenset((first.name, second.name)) not in self._unchecked
        )


def padding(bodies: Sequence[Body], pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the clearance that each pair must keep, shape (pairs,) [m]: links are padded against objects only."""
    thick_m = np.array([body.padding_m for body in bodies])
    link = np.array([body.is_link for body in bodies])
    first, second = pairs.T
    return np.where(link[first] != link[second], thick_m[first] + thick_m[second], 0.0)


@dataclass(frozen=True)
class CollidingPair:
    """Two links, or a link and an object, that overlap.

    Attributes:
        first: one of them.
        second: the other.
        depth_m: how deep [m].
        point_m: the middle of the overlap, in the robot's root link [m].
        normal: unit vector there, the way that the second one would have to give.
    """

    first: str
    second: str
    depth_m: float
    point_m: Point = ZERO
    normal: Point = ZERO

    @property
    def links(self) -> frozenset[str]:
        """The two names, in no order."""
        return frozenset((self.first, self.second))


class CollisionModel:
    """Collisions, link positions and travel of one robot in one scene.

    A configuration ``q`` is the position of every movable joint in the order of ``joint_names``, shape (n,) [rad].
    Checks use the robot's hulls, which are larger than its links. Two kinds of pairs of names can be excepted:
    ``allowed`` ones may overlap, and how deep is said, as :meth:`overlaps_m` tells it [m]; for ``closer`` ones the
    hulls' contact does not count, only that of their parts or of their surfaces.

    Args:
        robot: its hulls are used, or else the collision shapes of its URDF.

    Raises:
        ShapeError: the shapes cannot be used.

    Attributes:
        joint_names: joints of a configuration.
        lower_rad: shape (n,), lower position limits.
        upper_rad: shape (n,), upper position limits.
        travel_m_per_rad: shape (n,), the most that any point of the robot or of what it holds moves per motion of
            each joint.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._model = pin.buildModelFromXML(kinematic_urdf(robot))
        self._data = self._model.createData()
        # Loaded once: the meshes of an arm can take a second.
        exact = None if robot.hulls else urdf_shapes(robot, self._model)
        self._shapes = robot_shapes(robot, self._model, exact)
        self._exact = ExactShapes(robot, self._model, exact)
        self._reach = Reach(self._model)
        self._links_reach_m = self._reach.of_shapes(self._shapes)
        self._frames_reach_m = self._reach.of_frames()
        self._farthest_m = max(self._reach.farthest_m(shape) for shape in self._shapes)
        self._joints = JointMap(robot, self._model)
        self.joint_names = self._joints.joint_names
        joints = [robot.joints[name] for name in self.joint_names]
        self.lower_rad = np.array([joint.lower for joint in joints])
        self.upper_rad = np.array([joint.upper for joint in joints])
        self._build(EMPTY_SCENE)

    def set_scene(self, scene: Scene) -> PlanningFailure | None:
        """Take over a scene; nothing is done for a version that is there already.

        Returns:
            The flaw of a scene that cannot be used, which leaves the scene before in place; else None.
        """
        if scene.version == self._version:
            return None
        refusal = check_scene(scene, self._robot.links)
        if refusal is None:
            self._build(scene)
        return refusal

    def in_collision(
        self,
        q: Vector,
        allowed: Mapping[frozenset[str], float] = NO_CONTACT,
        closer: Closer = NONE_CLOSER,
    ) -> bool:
        """Tell whether a checked pair touches.

        Args:
            q: configuration.
            allowed: pairs of names that may overlap, and how deep [m].
            closer: pairs of names of which closer shapes than the hulls count.
        """
        if not self._broadphase.touches(q):
            return False
        if not allowed and not closer:
            return True
        return self._any_touches(self._broadphase.touching(q), allowed, closer)

    def margins_m(self, joint_travel: Vector) -> Vector:
        """Return by how much the shapes of each pair can approach when the joints move so far [m].

        Args:
            joint_travel: shape (m, n) [rad].

        Returns:
            Shape (m, pairs) [m].
        """
        margins_m: Vector = joint_travel @ self._approach_m.T
        return margins_m

    def candidate_pairs(
        self,
        q: Vector,
        margin_m: Vector,
        among: Sequence[int] | None = None,
        allowed: Mapping[frozenset[str], float] = NO_CONTACT,
        closer: Closer = NONE_CLOSER,
    ) -> tuple[int, ...]:
        """Return the pairs of shapes that are nearer than their clearance and a margin.

        Args:
            q: configuration.
            margin_m: of each pair, shape (pairs,) [m].
            among: indices of the pairs to check; None for all.
            allowed: as for :meth:`in_collision`.
            closer: as for :meth:`in_collision`.
        """
        broadphase = self._broadphase
        near = broadphase.near(q, margin_m) if among is None else broadphase.near_among(q, among, margin_m)
        if near and (allowed or closer):
            broadphase.place(q)
            near = [pair for pair in near if not self._excused(pair, float(margin_m[pair]), allowed, closer)]
        return tuple(near)

    def touch_among(
        self,
        q: Vector,
        among: Sequence[int],
        allowed: Mapping[frozenset[str], float] = NO_CONTACT,
        closer: Closer = NONE_CLOSER,
    ) -> bool:
        """As :meth:`in_collision`, of the pairs of shapes with some indices only."""
        self._broadphase.place(q)
        return self._any_touches(self._broadphase.touching_among(among), allowed, closer)

    def colliding_pairs(self, q: Vector, closer: Closer | None = None) -> list[CollidingPair]:
        """Every pair of links or objects that overlaps, deepest first.

        Args:
            q: configuration.
            closer: as for :meth:`in_collision`; None for all pairs by their closest shapes.
        """
        deepest: dict[frozenset[str], CollidingPair] = {}
        for index in self._broadphase.touching(q):
            first, second = (self._bodies[i].name for i in self._pairs[index])
            pair = CollidingPair(first, second, max(0.0, -self._broadphase.distance_m(index)))
            known = deepest.get(pair.links)
            if known is not None and known.depth_m >= pair.depth_m:
                continue
            closeness = Closeness.SURFACES if closer is None else closer.get(pair.links)
            if closeness is not None and self._apart(index, 0.0, closeness):
                continue
            point_m, normal = map(_point, self._broadphase.contact(index))
            deepest[pair.links] = replace(pair, point_m=point_m, normal=normal)
        return sorted(deepest.values(), key=lambda pair: -pair.depth_m)

    def overlaps_m(self, q: Vector) -> dict[frozenset[str], float]:
        """Return the depth of overlap of pairs of names, by the most exact shapes known of them [m]."""
        deepest_m: dict[frozenset[str], float] = {}
        for pair in self._broadphase.touching(q):
            if not self._apart(pair, 0.0, Closeness.SURFACES):
                names = self._names[pair]
                deepest_m[names] = max(deepest_m.get(names, 0.0), self._overlap_m(pair))
        return deepest_m

    def collides(self, q: Vector, closeness: Closeness = Closeness.SURFACES) -> bool:
        """Tell whether anything overlaps by closer shapes than the hulls, where these are known."""
        return any(not self._apart(pair, 0.0, closeness) for pair in self._broadphase.touching(q))

    def tight_pairs(self, q: Vector, closest: Closeness = Closeness.SURFACES) -> dict[frozenset[str], Closeness]:
        """Pairs of names that overlap in their hulls but not in closer shapes: to be passed on as ``closer``.

        Args:
            q: configuration.
            closest: the closest shapes that are asked.
        """
        if not self._exact.available:
            return {}
        tight: dict[frozenset[str], Closeness] = {}
        for pair in self._broadphase.touching(q):
            names = self._names[pair]
            asked = (closeness for closeness in Closeness if closeness <= closest)
            apart = (closeness for closeness in asked if self._apart(pair, 0.0, closeness))
            if (closeness := next(apart, None)) is not None:
                tight[names] = max(closeness, tight.get(names, closeness))
        return tight

    def near_pairs(self, q: Vector, within_m: float) -> list[NearPair]:
        """Pairs that are nearer than a distance, and how that changes: by their hulls while these are apart.

        Args:
            q: configuration.
            within_m: the distance, beyond what they must be apart anyway [m].
        """
        self._broadphase.turn(q)
        found = [(index, self._nearest(index)) for index in self._broadphase.within(within_m).tolist()]
        near = [self._near_pair(index, nearest) for index, nearest in found]
        return [pair for pair in near if pair.distance_m < within_m]

    def tip_positions(self, configurations: Sequence[Vector] | Vector, link: str) -> Vector:
        """Origin of a link in each configuration, shape (n, 3) [m]."""
        frame = frame_of_link(self._model, link)
        positions = np.empty((len(configurations), 3))
        for i, q in enumerate(configurations):
            pin.forwardKinematics(self._model, self._data, self._joints.positions(q))
            positions[i] = pin.updateFramePlacement(self._model, self._data, frame).translation
        return positions

    def _build(self, scene: Scene) -> None:
        # Known once all is built: a scene that raises halfway counts as none, and is built again by the next request.
        self._version: int | None = None
        movers = link_bodies(self._model, self._shapes, scene)
        for attached in scene.attached:
            movers += attached_bodies(self._model, attached, self._farthest_m)
        added = [body.shape for body in movers[len(self._shapes) :]]
        farthest_m = max([self._farthest_m, *(self._reach.farthest_m(shape) for shape in added)])
        around = list(object_bodies(scene, farthest_m))
        resting = np.zeros((len(around), self._model.nv))
        reach_m = np.vstack((self._links_reach_m, self._reach.of_shapes(added), resting))
        self._scaled, self._bodies = frozenset(scene.link_scale), [*movers, *around]
        self._known_parts: dict[int, Parts] = {}
        self._pairs = PairFilter(self._robot, scene.allowed).pairs(movers, around)
        self._names = [frozenset(self._bodies[i].name for i in pair) for pair in self._pairs.tolist()]
        self._apart_m = padding(self._bodies, self._pairs)
        self._approach_m = self._joints.travel_by_joint(approach(reach_m, self._pairs))
        self.travel_m_per_rad = self._joints.travel_by_joint(np.vstack((reach_m, self._frames_reach_m))).max(axis=0)
        shapes = [body.shape for body in self._bodies]
        self._broadphase = Broadphase(self._model, shapes, self._pairs, self._apart_m, self._joints)
        self._version = scene.version

    def _any_touches(self, pairs: Sequence[int], allowed: Mapping[frozenset[str], float], closer: Closer) -> bool:
        """Tell whether any of the pairs whose hulls touch is not excused."""
        # A look at closer shapes takes up to a thousand times as long as this.
        if any(self._names[pair] not in closer and self._names[pair] not in allowed for pair in pairs):
            return True
        return not all(self._excused(pair, 0.0, allowed, closer) for pair in pairs)

    def _excused(self, pair: int, margin_m: float, allowed: Mapping[frozenset[str], float], closer: Closer) -> bool:
        """Tell whether a pair is as far apart as it must be, a margin included, although its hulls are not."""
        names = self._names[pair]
        depth_m = allowed[names] + DEPTH_ACCURACY_M - margin_m if names in allowed else -margin_m
        if names in allowed and -self._broadphase.distance_m(pair) <= depth_m:
            return True
        by_parts = names in allowed and self._exact.solid and not names & self._scaled
        if by_parts and not deeper_than(*self._parts_of_pair(pair), depth_m - float(self._apart_m[pair])):
            return True
        return names in closer and self._apart(pair, margin_m, closer[names])

    def _overlap_m(self, pair: int) -> float:
        """Return an upper bound of a pair's overlap, negative for hulls beyond their required clearance [m]."""
        by_hulls_m = -self._broadphase.distance_m(pair)
        if by_hulls_m <= 0.0 or not self._exact.solid or self._names[pair] & self._scaled:
            return by_hulls_m
        # What overlaps is within both.
        return min(by_hulls_m, overlap_m(*self._parts_of_pair(pair)) + float(self._apart_m[pair]))

    def _nearest(self, pair: int) -> Nearest:
        """Return the nearest points of a pair's shapes; by their parts where only their hulls may be in the way."""
        by_hulls = self._broadphase.nearest(pair)
        if by_hulls.distance_m > HULL_EXCESS_M or not self._exact.solid or self._names[pair] & self._scaled:
            return by_hulls
        return nearest(*self._parts_of_pair(pair))

    def _near_pair(self, pair: int, nearest: Nearest) -> NearPair:
        first, second = (self._bodies[i] for i in self._pairs[pair])
        return NearPair(
            first.name,
            second.name,
            not (first.is_link and second.is_link),
            nearest.distance_m - float(self._apart_m[pair]),
            self._broadphase.slope_m_per_rad(pair, nearest),
        )

    def _apart(self, pair: int, margin_m: float, closeness: Closeness) -> bool:
        """Tell whether closer shapes of a pair than its hulls are known and further apart than a margin [m]."""
        names = self._names[pair]
        if not self._exact.available or names & self._scaled:
            return False
        margin_m += float(self._apart_m[pair])
        meshes = self._meshes_of_pair(pair)
        links = [self._bodies[index].is_link for index in self._pairs[pair]]
        parts = self._parts_of_pair(pair)
        if nearer_than(*parts, margin_m):
            if closeness is Closeness.PARTS or not self._exact.meshes or margin_m > MESH_MARGIN_M:
                return False
            if deeper_than(*parts, MESH_EXCUSE_M):
                return False
            if nearer_than(*meshes, margin_m + sum(links) * self._exact.mesh_accuracy_m):
                return False
        # Parts are not everywhere inside a link, and triangles nowhere. An object of triangles is a shell like a room.
        return not (links[0] and encloses(*meshes)) and not (links[1] and encloses(*meshes[2:], *meshes[:2]))

    def _meshes_of_pair(self, pair: int) -> tuple[Parts, pin.SE3, Parts, pin.SE3]:
        first, second = self._pairs[pair].tolist()
        return *self._meshes_of(first), *self._meshes_of(second)

    def _meshes_of(self, index: int) -> tuple[Parts, pin.SE3]:
        parts, place = self._exact_parts(index)
        body = self._bodies[index]
        return (self._exact.meshes.get(body.name, parts) if body.is_link else parts), place

    def _parts_of_pair(self, pair: int) -> tuple[Parts, pin.SE3, Parts, pin.SE3]:
        first, second = self._pairs[pair].tolist()
        return *self._exact_parts(first), *self._exact_parts(second)

    def _exact_parts(self, index: int) -> tuple[Parts, pin.SE3]:
        body = self._bodies[index]
        # Measuring an object takes ten times as long as a check of its pairs.
        if index not in self._known_parts:
            self._known_parts[index] = self._exact.of_link(body.name) if body.is_link else parts_of([body.shape])
        return self._known_parts[index], self._broadphase.placement(body.shape.parentJoint)


def _point(vector: Vector) -> Point:
    x, y, z = vector.tolist()
    return x, y, z
