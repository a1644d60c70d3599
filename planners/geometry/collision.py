"""Collision model of the robot and its scene: checked pairs, contacts and distances."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.broadphase import CONTACT_M, NO_PAIRS, Broadphase, Nearest, NearPair
from planners.geometry.kinematics import JointMap, Reach, approach
from planners.geometry.parts import PartPair, Parts, RobotParts, parts_of
from planners.geometry.shapes import (
    as_point,
    frame_of_link,
    kinematic_urdf,
    link_name,
    placement,
    robot_shapes,
    scaled,
    solid,
    urdf_shapes,
)
from planners.problem import PlanningFailure
from planners.scene import EMPTY_SCENE, ZERO, AttachedObject, Point, Scene
from planners.scene_checks import check_scene
from robot.description.model import RobotModel
from robot.trajectory import Vector

DEPTH_ACCURACY_M = 0.0002  # depths of the same contact differ by this much between runs of the penetration algorithm
HULL_EXCESS_M = 0.02  # a hull reaches at most this far beyond its link

# Hulls that are further apart than this share of a margin need no check of parts, which takes up to a hundred times as
# long as one of hulls: a few steps by the hulls lead as far.
COARSE_SHARE = 0.2

NO_CONTACT: Mapping[frozenset[str], float] = {}


@dataclass(frozen=True)
class Body:
    """One shape of a link or an object."""

    name: str  # name of the link or the object
    shape: pin.GeometryObject  # where it is and what carries it
    is_link: bool  # whether it belongs to the robot itself
    meets_links: bool = True  # whether it is checked against links
    meets_objects: bool = True  # whether it is checked against objects
    may_touch: frozenset[str] = frozenset()  # names of links that it may touch
    padding_m: float = 0.0  # how much thicker it is when it meets objects [m]


def link_bodies(model: pin.Model, shapes: Sequence[pin.GeometryObject], scene: Scene) -> list[Body]:
    """Return one body for each shape of the robot; after these one for each scaled shape, which only objects meet."""
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
    """Yield the bodies of an attached object; a plane is left out further than ``reach_m`` from the robot."""
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


def checked_pairs(
    robot: RobotModel, allowed: Mapping[frozenset[str], bool], movers: Sequence[Body], resting: Sequence[Body]
) -> NDArray[np.int64]:
    """Return the indices of bodies that are checked against each other, ``movers`` and then ``resting``, (pairs, 2).

    The smaller index comes first. Bodies that do not move against each other are not checked: links of one joint, the
    root link and the world; neither are neighbours and the pairs that the SRDF disables. ``allowed`` has pairs of
    names that may touch or may not, whatever the SRDF says.
    """
    adjacent = {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}
    unchecked = {names for names in adjacent | robot.disabled_pairs if allowed.get(names, True)}
    unchecked |= {names for names, may_touch in allowed.items() if may_touch}

    def checked(first: Body, second: Body) -> bool:
        return (
            first.shape.parentJoint != second.shape.parentJoint
            and (first.meets_links if second.is_link else first.meets_objects)
            and (second.meets_links if first.is_link else second.meets_objects)
            and first.name not in second.may_touch
            and second.name not in first.may_touch
            and frozenset((first.name, second.name)) not in unchecked
        )

    bodies = [*movers, *resting]
    pairs = ((i, j) for i in range(len(movers)) for j in range(i + 1, len(bodies)))
    found = [(i, j) for i, j in pairs if checked(bodies[i], bodies[j])]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class CollidingPair:
    """Two links, or a link and an object, that overlap."""

    first: str
    second: str
    depth_m: float
    point_m: Point = ZERO  # the middle of the overlap, in the robot's root link [m]
    normal: Point = ZERO  # unit vector there, the way that the second one would have to give

    @property
    def links(self) -> frozenset[str]:
        """The two names, in no order."""
        return frozenset((self.first, self.second))


class CollisionModel:
    """Collisions, link positions and travel of one robot in one scene.

    A configuration ``q`` is the position of every movable joint in the order of ``joint_names``, shape (n,) [rad];
    ``lower_rad`` and ``upper_rad`` are the limits. ``travel_m_per_rad`` is the most that any point of the robot or of
    what it holds moves per motion of each joint, shape (n,), and ``approach_m_per_rad`` the most that each checked pair
    comes nearer, shape (pairs, n).

    Checks use the robot's hulls, which are larger than its links, or else the collision shapes of its URDF. Two kinds
    of pairs of names are excepted: ``allowed`` ones may overlap by a depth, as :meth:`overlaps_m` measures it [m];
    ``refined`` ones are checked by their parts. ShapeError: the shapes cannot be used.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._model = pin.buildModelFromXML(kinematic_urdf(robot))
        self._data = self._model.createData()
        # Loaded once: the meshes of an arm can take a second.
        urdf = None if robot.hulls else urdf_shapes(robot, self._model)
        self._shapes = robot_shapes(robot, self._model, urdf)
        self._parts = RobotParts(robot, self._model, urdf)
        self._reach = Reach(self._model)
        self._links_reach_m = self._reach.of_shapes(self._shapes)
        self._frames_reach_m = self._reach.of_frames()
        self._farthest_m = max(self._reach.farthest_m(shape) for shape in self._shapes)
        self._joints = JointMap(robot, self._model)
        self.joint_names = self._joints.joint_names
        joints = [robot.joints[name] for name in self.joint_names]
        self.lower_rad = np.array([joint.lower for joint in joints])
        self.upper_rad = np.array([joint.upper for joint in joints])
        self._unchanged: frozenset[int] = frozenset()
        self._build(EMPTY_SCENE)

    def set_scene(self, scene: Scene) -> PlanningFailure | None:
        """Take over a scene unless it is there; return the flaw of an unfit scene, which changes nothing."""
        if scene.version == self._version:
            return None
        refusal = check_scene(scene, self._robot.links)
        if refusal is None:
            self._build(scene)
        return refusal

    def start(self, positions_rad: Mapping[str, float], moving: Collection[str]) -> Vector:
        """Return the start of a motion within the limits, beyond which positions may lie a little.

        Contacts there that the ``moving`` joints cannot change do not count until the next start or
        :meth:`count_all_contacts`: a relaxed arm that sags onto itself blocks no motion of another arm.
        """
        q = np.clip([positions_rad[name] for name in self.joint_names], self.lower_rad, self.upper_rad)
        columns = [self.joint_names.index(name) for name in moving]
        touching = self._broadphase.touching(q)
        self._unchanged = frozenset(pair for pair in touching if not self.approach_m_per_rad[pair, columns].any())
        return q

    def count_all_contacts(self) -> None:
        """Count contacts again that the last :meth:`start` left out."""
        self._unchanged = frozenset()

    def in_collision(
        self, q: Vector, refined: frozenset[int] = NO_PAIRS, allowed: Mapping[frozenset[str], float] = NO_CONTACT
    ) -> bool:
        """Return true if a checked pair touches; the allowed names' pairs are among the ``refined`` ones."""
        if self._broadphase.touches(q, refined | self._unchanged if self._unchanged else refined):
            return True
        touching = refined and self._broadphase.touching_among(q, refined - self._unchanged)
        return bool(touching) and any(not self._is_allowed(pair, allowed) for pair in touching)

    def near(
        self, q: Vector, margin_m: Sequence[float] | Vector, among: Sequence[int] | None = None
    ) -> list[tuple[int, float]]:
        """Return the pairs of hulls nearer than clearance and margin [m], and their distance beyond the clearance [m].

        ``margin_m`` has one for each pair ``among`` some, or of all. Pairs that touch have a distance of 0 or less.
        """
        broadphase = self._broadphase
        near = broadphase.near(q, np.asarray(margin_m)) if among is None else broadphase.near_among(q, among, margin_m)
        return [each for each in near if each[0] not in self._unchanged] if self._unchanged else near

    def pairs_of(self, names: Collection[frozenset[str]]) -> list[int]:
        """Return the pairs of some pairs of names."""
        return [pair for pair, each in enumerate(self._names) if each in names] if names else []

    def clearance_m(self, q: Vector, pair: int, margin_m: float) -> float:
        """Return how much nearer the hulls of a pair could come, 0 or less in contact, at most ``margin_m`` [m]."""
        return self._broadphase.clearance_m(q, pair, margin_m)

    def refined_clearance_m(
        self, q: Vector, pair: int, margin_m: float, allowed: Mapping[frozenset[str], float]
    ) -> float:
        """As :meth:`clearance_m`, of a refined pair, which may have an allowed overlap."""
        clearance_m, names = self._broadphase.clearance_m(q, pair, margin_m), self._names[pair]
        if clearance_m == margin_m > 0.0:
            return margin_m
        if names in allowed:
            clearance_m = min(margin_m, allowed[names] + DEPTH_ACCURACY_M - self._overlap_m(pair))
        if (clearance_m > 0.0 and clearance_m >= COARSE_SHARE * margin_m) or not self._has_parts(pair):
            return clearance_m
        parts = self._parts_of_pair(pair)
        by_parts_m = parts.nearest().distance_m - float(self._apart_m[pair]) - CONTACT_M
        return by_parts_m if by_parts_m > 0.0 and not self._enclose(pair, parts) else clearance_m

    def colliding_pairs(self, q: Vector, refined: Collection[frozenset[str]] | None = None) -> list[CollidingPair]:
        """Return every pair that overlaps, deepest first; by parts for ``refined`` pairs, for all where it is None."""
        deepest: dict[frozenset[str], CollidingPair] = {}
        for index in self._touching(q):
            first, second = (self._bodies[i].name for i in self._pairs[index])
            nearest = self._broadphase.nearest(index)
            depth_m = max(0.0, float(self._apart_m[index]) - nearest.distance_m)
            pair = CollidingPair(first, second, depth_m, as_point(nearest.middle_m), as_point(nearest.normal))
            known = deepest.get(pair.links)
            if known is not None and known.depth_m >= pair.depth_m:
                continue
            if (refined is None or pair.links in refined) and self._apart(index):
                continue
            deepest[pair.links] = pair
        return sorted(deepest.values(), key=lambda pair: -pair.depth_m)

    def overlaps_m(self, q: Vector) -> dict[frozenset[str], float]:
        """Return the depth of overlap of pairs of names, by their parts where these are known [m]."""
        deepest_m: dict[frozenset[str], float] = {}
        for pair in self._touching(q):
            if not self._apart(pair):
                names = self._names[pair]
                deepest_m[names] = max(deepest_m.get(names, 0.0), self._overlap_m(pair))
        return deepest_m

    def collides(self, q: Vector) -> bool:
        """Return true if anything overlaps by its parts, where these are known."""
        return any(not self._apart(pair) for pair in self._touching(q))

    def hull_only_pairs(self, q: Vector) -> set[frozenset[str]]:
        """Return the pairs of names that overlap in their hulls but not in their parts: to be checked ``refined``."""
        return {self._names[pair] for pair in self._touching(q) if self._apart(pair)}

    def near_pairs(self, q: Vector, within_m: float, moving: Collection[str] = ()) -> list[NearPair]:
        """Return the pairs nearer than a distance beyond their clearance [m], with gradients, for ``moving`` joints."""
        found: dict[int, Nearest] = {}
        candidates = self._broadphase.near(q, np.full(len(self._pairs), within_m))
        self._broadphase.turn(q)
        for pair, _ in candidates:
            nearest = self._broadphase.nearest(pair)
            # Only the hulls may be in the way.
            if nearest.distance_m <= HULL_EXCESS_M and self._has_convex_parts(pair):
                nearest = self._parts_of_pair(pair).nearest()
            if nearest.distance_m - self._apart_m[pair] < within_m:
                found[pair] = nearest
        columns = [self.joint_names.index(name) for name in moving]
        by_others = np.logical_and(self._carried.any(axis=1), ~self._carried[:, columns].any(axis=1))
        near = []
        for (pair, nearest), gradient in zip(found.items(), self._broadphase.distance_gradients(found), strict=True):
            first, second = (self._bodies[i] for i in self._pairs[pair])
            by_object = not (first.is_link and second.is_link)
            distance_m = nearest.distance_m - float(self._apart_m[pair])
            by_another_arm = bool(by_others[self._pairs[pair]].any())
            near.append(NearPair(first.name, second.name, by_object, distance_m, gradient, by_another_arm))
        return near

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
        self._unchanged = frozenset()
        self._pairs = checked_pairs(self._robot, scene.allowed, movers, around)
        self._names = [frozenset(self._bodies[i].name for i in pair) for pair in self._pairs.tolist()]
        thick_m = np.array([body.padding_m for body in self._bodies])
        link = np.array([body.is_link for body in self._bodies])
        first, second = self._pairs.T
        # Links are padded against objects only.
        self._apart_m = np.where(link[first] != link[second], thick_m[first] + thick_m[second], 0.0)
        # Whether each joint carries each body.
        self._carried = self._joints.by_joint(reach_m, bounds=True) > 0.0
        self.approach_m_per_rad: Vector = self._joints.by_joint(approach(reach_m, self._pairs), bounds=True)
        travel_m = np.vstack((reach_m, self._frames_reach_m))
        self.travel_m_per_rad = self._joints.by_joint(travel_m, bounds=True).max(axis=0)
        shapes = [body.shape for body in self._bodies]
        self._broadphase = Broadphase(self._model, shapes, self._pairs, self._apart_m, self._joints)
        self._version = scene.version

    def _touching(self, q: Vector) -> list[int]:
        """Return the pairs that touch and count, with the shapes placed at a configuration."""
        return [pair for pair in self._broadphase.touching(q) if pair not in self._unchanged]

    def _is_allowed(self, pair: int, allowed: Mapping[frozenset[str], float]) -> bool:
        """Return true if a refined pair is as far apart as it must be although its hulls are not."""
        names = self._names[pair]
        if names in allowed:
            depth_m = allowed[names] + DEPTH_ACCURACY_M
            if -self._broadphase.distance_m(pair) <= depth_m:
                return True
            by_parts = self._has_convex_parts(pair)
            if by_parts and not self._parts_of_pair(pair).deeper_than(depth_m - float(self._apart_m[pair])):
                return True
        return self._apart(pair)

    def _overlap_m(self, pair: int) -> float:
        """Return an upper bound of a pair's overlap, negative for hulls beyond their required clearance [m]."""
        by_hulls_m = -self._broadphase.distance_m(pair)
        if by_hulls_m <= 0.0 or not self._has_convex_parts(pair):
            return by_hulls_m
        # The overlap is within both.
        return min(by_hulls_m, float(self._apart_m[pair]) - self._parts_of_pair(pair).nearest().distance_m)

    def _apart(self, pair: int) -> bool:
        """Return true if parts of a pair are known and as far apart as they must be, none inside the other body."""
        if not self._has_parts(pair):
            return False
        parts = self._parts_of_pair(pair)
        if parts.nearer_than(float(self._apart_m[pair])):
            return False
        return not self._enclose(pair, parts)

    def _enclose(self, pair: int, parts: PartPair) -> bool:
        """Return true if a body of a pair is inside the other, whose parts it does not touch."""
        # Parts are not everywhere inside a link, and triangles nowhere. An object of triangles is a shell like a room.
        return parts.encloses(*(self._bodies[index].is_link for index in self._pairs[pair]))

    def _has_parts(self, pair: int) -> bool:
        return self._parts.available and not self._names[pair] & self._scaled

    def _has_convex_parts(self, pair: int) -> bool:
        return self._parts.convex and self._has_parts(pair)

    def _parts_of_pair(self, pair: int) -> PartPair:
        first, second = self._pairs[pair].tolist()
        return PartPair(*self._parts_of_body(first), *self._parts_of_body(second))

    def _parts_of_body(self, index: int) -> tuple[Parts, pin.SE3]:
        body = self._bodies[index]
        # Measuring an object takes ten times as long as a check of its pairs.
        if index not in self._known_parts:
            self._known_parts[index] = self._parts.of_link(body.name) if body.is_link else parts_of([body.shape])
        return self._known_parts[index], self._broadphase.placement(body.shape.parentJoint)
