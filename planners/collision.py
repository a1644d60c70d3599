"""Does the robot touch itself, where are its links, and how far does it move: pinocchio and coal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.shapes import collision_geometry, link_name
from planners.skeleton import kinematic_urdf
from planners.travel import travel_per_joint
from robot.model import RobotModel

Vector = NDArray[np.float64]

# With coal's default of 1e-6 one pair in 80 000 that overlaps, by up to 48 mm, is called free: the search for a common
# point gives up too early on shapes of a few centimetres. With this none of 1.6 million was, at no cost.
GJK_TOLERANCE = 1e-9

# Depths of the same contact differ by this much between runs of the penetration algorithm.
DEPTH_ACCURACY_M = 0.0002

NO_CONTACT: Mapping[frozenset[str], float] = {}


@dataclass(frozen=True)
class CollidingPair:
    """Two links that overlap by ``depth_m`` [m]."""

    first: str
    second: str
    depth_m: float

    @property
    def links(self) -> frozenset[str]:
        """The two links, in no order."""
        return frozenset((self.first, self.second))


class CollisionModel:
    """Collisions, link positions and travel of one robot.

    A configuration ``q`` is the position of every movable joint in the order of ``joint_names``, shape (n,) [rad].

    Args:
        robot: its hulls are used, or else the collision shapes of its URDF.

    Raises:
        ShapeError: the shapes cannot be used.

    Attributes:
        joint_names: joints of a configuration.
        lower_rad: shape (n,), lower position limits.
        upper_rad: shape (n,), upper position limits.
        travel_m_per_rad: shape (n,), the most that any robot point moves per motion of each joint.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._model = pin.buildModelFromXML(kinematic_urdf(robot))
        self._data = self._model.createData()
        self._geometry = collision_geometry(robot, self._model)
        self._geometry_data = self._geometry.createData()
        for request in self._geometry_data.collisionRequests:
            request.gjk_tolerance = GJK_TOLERANCE
        # The tree keeps references to both models, and halves the time of a check even for seven shapes.
        self._broadphase = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._model, self._geometry, self._geometry_data
        )
        self.joint_names = tuple(str(name) for name in list(self._model.names)[1:])
        joints = [robot.joints[name] for name in self.joint_names]
        self.lower_rad = np.array([joint.lower for joint in joints])
        self.upper_rad = np.array([joint.upper for joint in joints])
        self.travel_m_per_rad = travel_per_joint(self._model, self._geometry)

    def in_collision(self, q: Vector, allowed: Mapping[frozenset[str], float] = NO_CONTACT) -> bool:
        """Whether links touch that must not.

        Args:
            q: configuration.
            allowed: pairs of links that may overlap, and how deep [m].
        """
        if not pin.computeCollisions(self._model, self._data, self._broadphase, q, True):
            return False
        return not allowed or any(
            pair.depth_m > allowed.get(pair.links, -1.0) + DEPTH_ACCURACY_M for pair in self.colliding_pairs(q)
        )

    def colliding_pairs(self, q: Vector) -> list[CollidingPair]:
        """Every pair of links that overlaps, deepest first."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        deepest: dict[frozenset[str], CollidingPair] = {}
        for pair in self._overlaps():
            known = deepest.get(pair.links)
            if known is None or known.depth_m < pair.depth_m:
                deepest[pair.links] = pair
        return sorted(deepest.values(), key=lambda pair: -pair.depth_m)

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

    def _overlaps(self) -> Iterator[CollidingPair]:
        for index, pair in enumerate(self._geometry.collisionPairs):
            if pin.computeCollision(self._geometry, self._geometry_data, index):
                distance = pin.computeDistance(self._geometry, self._geometry_data, index)
                shapes = self._geometry.geometryObjects
                first, second = (link_name(self._model, shapes[i]) for i in (pair.first, pair.second))
                yield CollidingPair(first, second, max(0.0, -float(distance.min_distance)))
