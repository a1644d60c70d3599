"""Does the robot touch itself, its surroundings or what it holds; where are its links, and how far do they move?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.broadphase import Broadphase
from planners.geometry.exact import ExactShapes, Parts, nearer_than, overlap_m, parts_of
from planners.geometry.pairs import Body, Rules, held_by, links_of, padding, standing
from planners.geometry.shapes import robot_shapes
from planners.geometry.skeleton import kinematic_urdf
from planners.geometry.travel import Reach, approach
from planners.geometry.world import check_scene
from planners.problem import PlanningFailure
from planners.scene import EMPTY_SCENE, Scene
from robot.model import RobotModel

Vector = NDArray[np.float64]

# Depths of the same contact differ by this much between runs of the penetration algorithm.
DEPTH_ACCURACY_M = 0.0002

NO_CONTACT: Mapping[frozenset[str], float] = {}
NO_PAIRS: frozenset[frozenset[str]] = frozenset()


@dataclass(frozen=True)
class CollidingPair:
    """Two links, or a link and an object, that overlap by ``depth_m`` [m]."""

    first: str
    second: str
    depth_m: float

    @property
    def links(self) -> frozenset[str]:
        """The two names, in no order."""
        return frozenset((self.first, self.second))


class CollisionModel:
    """Collisions, link positions and travel of one robot in one scene.

    A configuration ``q`` is the position of every movable joint in the order of ``joint_names``, shape (n,) [rad].
    Checks use the robot's hulls, which are larger than its links. Two kinds of pairs of names can be excepted:
    ``allowed`` ones may overlap, and how deep is said, as :meth:`overlaps_m` tells it [m]; for pairs ``by_mesh`` the
    hulls' contact does not count, only that of the meshes they enclose.

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
        self._shapes = robot_shapes(robot, self._model)
        self._exact = ExactShapes(robot, self._model)
        self._reach = Reach(self._model)
        self._links_reach_m = self._reach.of_shapes(self._shapes)
        self._frames_reach_m = self._reach.of_frames()
        self._farthest_m = max(self._reach.farthest_m(shape) for shape in self._shapes)
        self.joint_names = tuple(str(name) for name in list(self._model.names)[1:])
        joints = [robot.joints[name] for name in self.joint_names]
        self.lower_rad = np.array([joint.lower for joint in joints])
        self.upper_rad = np.array([joint.upper for joint in joints])
        self._build(EMPTY_SCENE)

    def set_scene(self, scene: Scene) -> PlanningFailure | None:
        """Take over what stands around and what is held; nothing is done for a version that is there already.

        Returns:
            What is wrong with the scene: then the one before stays.
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
        by_mesh: frozenset[frozenset[str]] = NO_PAIRS,
    ) -> bool:
        """Whether things touch that must not.

        Args:
            q: configuration.
            allowed: pairs of names that may overlap, and how deep [m].
            by_mesh: pairs of names of which only the meshes count.
        """
        if not self._broadphase.touches(q):
            return False
        if not allowed and not by_mesh:
            return True
        self._broadphase.place(q)
        return not all(self._excused(pair, 0.0, allowed, by_mesh) for pair in self._broadphase.touching())

    def free_around(
        self,
        configurations: Vector,
        joint_travel: Vector,
        allowed: Mapping[frozenset[str], float] = NO_CONTACT,
        by_mesh: frozenset[frozenset[str]] = NO_PAIRS,
    ) -> list[bool]:
        """Around which configurations nothing can touch, wherever the joints are in a range around each.

        Args:
            configurations: shape (m, n) [rad].
            joint_travel: how far each joint may be from each configuration, shape (n,) [rad].
            allowed: as for :meth:`in_collision`.
            by_mesh: as for :meth:`in_collision`.
        """
        margin_m = self._approach_m @ joint_travel
        self._broadphase.watch(margin_m)
        clear = [not self._broadphase.near(q) for q in configurations]
        if allowed or by_mesh:
            for i in (i for i, free in enumerate(clear) if not free):
                self._broadphase.place(configurations[i])
                close = self._broadphase.close()
                clear[i] = all(self._excused(pair, float(margin_m[pair]), allowed, by_mesh) for pair in close)
        return clear

    def colliding_pairs(self, q: Vector, by_mesh: frozenset[frozenset[str]] | None = None) -> list[CollidingPair]:
        """Every pair of links or objects that overlaps, deepest first.

        Args:
            q: configuration.
            by_mesh: pairs of names whose hulls' overlap does not count, but that of what they enclose; None for all.
        """
        self._broadphase.place(q)
        deepest: dict[frozenset[str], CollidingPair] = {}
        for index in self._broadphase.touching():
            first, second = (self._bodies[i].name for i in self._pairs[index])
            pair = CollidingPair(first, second, max(0.0, -self._broadphase.distance_m(index)))
            known = deepest.get(pair.links)
            if known is not None and known.depth_m >= pair.depth_m:
                continue
            if (by_mesh is None or pair.links in by_mesh) and self._apart_by_mesh(index, 0.0):
                continue
            deepest[pair.links] = pair
        return sorted(deepest.values(), key=lambda pair: -pair.depth_m)

    def overlaps_m(self, q: Vector) -> dict[frozenset[str], float]:
        """How deep pairs of names overlap, by the closest shapes that are known of them [m]."""
        if not self._broadphase.touches(q):
            return {}
        self._broadphase.place(q)
        deepest_m: dict[frozenset[str], float] = {}
        for pair in self._broadphase.touching():
            if not self._apart_by_mesh(pair, 0.0):
                names = self._names(pair)
                deepest_m[names] = max(deepest_m.get(names, 0.0), self._overlap_m(pair))
        return deepest_m

    def tight_pairs(self, q: Vector) -> frozenset[frozenset[str]]:
        """Pairs of names of which only the hulls overlap and not the meshes: to be passed on as ``by_mesh``."""
        if not self._exact.available or not self._broadphase.touches(q):
            return NO_PAIRS
        self._broadphase.place(q)
        return frozenset(self._names(pair) for pair in self._broadphase.touching() if self._apart_by_mesh(pair, 0.0))

    def tip_position(self, q: Vector, link: str) -> Vector:
        """Origin of a link in the root link's frame, shape (3,) [m].

        Args:
            q: configuration.
            link: a link of the robot.
        """
        position_m: Vector = self.tip_positions([q], link)[0]
        return position_m

    def tip_positions(self, configurations: Sequence[Vector] | Vector, link: str) -> Vector:
        """Origin of a link in each configuration, shape (n, 3) [m]."""
        frame = self._model.getFrameId(link)
        positions = np.empty((len(configurations), 3))
        for i, q in enumerate(configurations):
            pin.forwardKinematics(self._model, self._data, q)
            positions[i] = pin.updateFramePlacement(self._model, self._data, frame).translation
        return positions

    def _build(self, scene: Scene) -> None:
        movers = links_of(self._model, self._shapes, scene)
        for attached in scene.attached:
            movers += held_by(self._model, attached, self._farthest_m)
        added = [body.shape for body in movers[len(self._shapes) :]]
        farthest_m = max([self._farthest_m, *(self._reach.farthest_m(shape) for shape in added)])
        around = list(standing(scene, farthest_m))
        resting = np.zeros((len(around), len(self.joint_names)))
        reach_m = np.vstack((self._links_reach_m, self._reach.of_shapes(added), resting))
        self._version, self._scaled, self._bodies = scene.version, frozenset(scene.link_scale), [*movers, *around]
        self._pairs = Rules(self._robot, scene.allowed).pairs(movers, around)
        self._apart_m = padding(self._bodies, self._pairs)
        self._approach_m = approach(reach_m, self._pairs)
        self.travel_m_per_rad = np.vstack((reach_m, self._frames_reach_m)).max(axis=0)
        self._broadphase = Broadphase(self._model, [b.shape for b in self._bodies], self._pairs, self._apart_m)

    def _names(self, pair: int) -> frozenset[str]:
        return frozenset(self._bodies[i].name for i in self._pairs[pair])

    def _excused(
        self, pair: int, margin_m: float, allowed: Mapping[frozenset[str], float], by_mesh: frozenset[frozenset[str]]
    ) -> bool:
        """Whether a pair is as far apart as it must be, a margin included, although its hulls are not."""
        names = self._names(pair)
        if names in allowed and self._overlap_m(pair) + margin_m <= allowed[names] + DEPTH_ACCURACY_M:
            return True
        return names in by_mesh and self._apart_by_mesh(pair, margin_m)

    def _overlap_m(self, pair: int) -> float:
        """How deep a pair overlaps at most, below 0 how far its hulls are apart beyond what they must be [m]."""
        by_hulls_m = -self._broadphase.distance_m(pair)
        if by_hulls_m <= 0.0 or not self._exact.solid or self._names(pair) & self._scaled:
            return by_hulls_m
        # What overlaps is within both.
        (first, at_first), (second, at_second) = (self._exact_parts(self._bodies[i]) for i in self._pairs[pair])
        return min(by_hulls_m, overlap_m(first, at_first, second, at_second) + float(self._apart_m[pair]))

    def _apart_by_mesh(self, pair: int, margin_m: float) -> bool:
        """Whether the meshes behind a pair's hulls are known and further apart than a margin [m]."""
        names = self._names(pair)
        if not self._exact.available or names & self._scaled:
            return False
        (first, at_first), (second, at_second) = (self._exact_parts(self._bodies[i]) for i in self._pairs[pair])
        return not nearer_than(first, at_first, second, at_second, margin_m + float(self._apart_m[pair]))

    def _exact_parts(self, body: Body) -> tuple[Parts, pin.SE3]:
        parts = self._exact.of_link(body.name) if body.is_link else parts_of([body.shape])
        return parts, self._broadphase.placement(body.shape.parentJoint)
