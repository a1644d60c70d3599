"""Planning scene: plain data in metres, in the robot's root link unless stated, with unit quaternions x, y, z, w."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

ZERO: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """A place and an orientation."""

    position_m: Point = ZERO
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Box:
    """A box around its origin, its whole edges along x, y, z [m]."""

    size_m: Point


@dataclass(frozen=True)
class Sphere:
    """A sphere around its origin."""

    radius_m: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z, its origin in the middle."""

    radius_m: float
    height_m: float


@dataclass(frozen=True)
class Cone:
    """A cone along z, its tip up, its origin half-way up."""

    radius_m: float
    height_m: float


@dataclass(frozen=True)
class Plane:
    """The half-space ``normal . x <= offset_m``: solid below, free above; the normal is a unit vector."""

    normal: Point
    offset_m: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles; its inside is not solid."""

    vertices_m: NDArray[np.float64]  # shape (n, 3) [m]
    triangles: NDArray[np.int32]  # shape (m, 3), indices into `vertices_m`


Shape = Box | Sphere | Cylinder | Cone | Plane | Mesh


@dataclass(frozen=True)
class SceneObject:
    """An object of one or several shapes."""

    name: str  # unlike any link's and any other object's
    shapes: tuple[tuple[Shape, Pose], ...]  # each with its pose in the object's frame
    pose: Pose = Pose()  # the object's frame in the robot's root link, or in the link that holds it


@dataclass(frozen=True)
class AttachedObject:
    """An object that moves with a link."""

    object: SceneObject  # the object, its pose in the link's frame
    link: str  # the link that holds it
    touch_links: frozenset[str] = frozenset()  # further links that may touch it


@dataclass(frozen=True)
class Scene:
    """Surroundings of the robot, and the contacts that are allowed."""

    version: int = 0  # a number that no other scene has; workers tell scenes apart by it
    objects: tuple[SceneObject, ...] = ()  # objects around the robot, each checked against every link that can move
    attached: tuple[AttachedObject, ...] = ()
    # Pair of names (links or objects) -> True: they may touch; False: they are checked though the SRDF disables them.
    # Pairs not named follow the SRDF.
    allowed: Mapping[frozenset[str], bool] = field(default_factory=dict)
    # By how much links are thicker than their shapes [m].
    link_padding_m: Mapping[str, float] = field(default_factory=dict)
    link_scale: Mapping[str, float] = field(default_factory=dict)  # factor by which links are larger than their shapes

    def all_objects(self) -> tuple[SceneObject, ...]:
        """Return the objects around the robot and those attached to it."""
        return (*self.objects, *(each.object for each in self.attached))


EMPTY_SCENE = Scene()
