"""Bodies around a simulated arm, and their poses, as they go between the server and the arm process.

Positions are in the frame of the arm's root link [m], orientations unit quaternions x, y, z, w.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

Point: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

DEFAULT_FRICTION = 1.0  # sliding friction of rubber or printed fingers on wood or plastic

# A world is compiled within a second with these; its process is silent meanwhile, and counts as hung after 5 s.
MAX_BODIES = 100
MAX_HULL_CORNERS = 200


@dataclass(frozen=True)
class BodyShape:
    """Shape of a body: a box, sphere or cylinder (along z) around its origin, a half-space, or a convex hull."""

    kind: Literal["box", "sphere", "cylinder", "plane", "hull"]
    # Half edges of a box; radius and half height of a cylinder; radius of a sphere; nothing of the others [m].
    size_m: tuple[float, ...]
    position_m: Point  # in the body's frame
    orientation: Quaternion
    vertices_m: tuple[Point, ...] = ()  # corners of a hull


@dataclass(frozen=True)
class Body:
    """Body at the pose where it was put."""

    name: str
    shapes: tuple[BodyShape, ...]
    position_m: Point
    orientation: Quaternion
    movable: bool = False  # False for a body that stays where it is
    mass_kg: float = 0.0  # 0 for a mass by its volume, as wood
    friction: float = DEFAULT_FRICTION


@dataclass(frozen=True)
class SetBodies:
    """Command to have these bodies in the world; bodies that are there already stay where they have come to."""

    version: int
    bodies: tuple[Body, ...]
    # Positions and orientations of movable bodies to be put somewhere for once, by name.
    placed: Mapping[str, tuple[Point, Quaternion]] = field(default_factory=dict)


@dataclass(frozen=True)
class BodyState:
    """Movable body in the world."""

    name: str
    position_m: Point
    orientation: Quaternion
    held: bool  # True while the gripper's fingers touch it on two sides


@dataclass(frozen=True)
class BodyStates:
    """Movable bodies that have moved, of the bodies of one :class:`SetBodies`."""

    version: int
    bodies: tuple[BodyState, ...]
