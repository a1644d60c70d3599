"""Collision shapes of a URDF's links, their convex parts and their surfaces, in the frames of the links.

``python -m planners.assistant.link_shapes URDF SRDF FILE`` writes the surfaces, for ``robot.surfaces`` of a
``robot.toml``: the surface of a link decides if a point is inside it.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.assistant.decomposition import MAX_TRIANGLES, Limits, decompose
from planners.assistant.surface import ConvexPart, Deviation, Surface, merged
from planners.errors import AssistantError
from planners.geometry.parts import Parts, parts_of
from planners.geometry.shapes import convex, corners, evenly_spread, kinematic_urdf, link_name, urdf_shapes
from planners.geometry.surfaces import joined, packed
from robot.description import model
from robot.description.model import RobotModel
from robot.trajectory import Vector

# Sides of the prism around a cylinder, and directions of the planes around a sphere: 0.5 % and 2 % wider.
SIDES = 32
SPHERE_POINTS, SPHERE_DIRECTIONS = 2000, 92


@dataclass(frozen=True)
class LinkShape:
    """One <collision> of a link."""

    geometry: coal.CollisionGeometry
    placement: pin.SE3  # pose in the link's frame

    @property
    def mesh(self) -> coal.BVHModelBase | None:
        """The mesh; None for a simple shape."""
        return self.geometry if isinstance(self.geometry, coal.BVHModelBase) else None


@dataclass(frozen=True)
class LinkParts:
    """Convex parts of a link."""

    parts: tuple[ConvexPart, ...]  # in the link's frame
    deviation: Deviation  # greatest deviation from the link's meshes; zero for a link without meshes
    meshes: int  # number of its meshes


def link_shapes(robot: RobotModel) -> dict[str, list[LinkShape]]:
    """Return the shapes of each link that has some, root first; AssistantError where no link has a shape."""
    model = pin.buildModelFromXML(kinematic_urdf(robot))
    found: dict[str, list[LinkShape]] = {link: [] for link in robot.links}
    for shape in urdf_shapes(robot, model):
        in_link = model.frames[shape.parentFrame].placement.actInv(shape.placement)
        found[link_name(model, shape)].append(LinkShape(shape.geometry, in_link))
    shaped = {link: shapes for link, shapes in found.items() if shapes}
    if not shaped:
        raise AssistantError("no link of the URDF has a <collision>: add one to each link that can touch something")
    return shaped


def convex_links(shapes: Mapping[str, list[LinkShape]], limits: Limits) -> Iterator[tuple[str, LinkParts]]:
    """Yield the convex parts of each link, as soon as they are found."""
    known: dict[bytes, tuple[list[Vector], Deviation]] = {}
    for link, of_link in shapes.items():
        parts: list[ConvexPart] = []
        deviation = Deviation()
        for shape in of_link:
            if shape.mesh is not None:
                surface = surface_of(link, shape.mesh)
                key = hashlib.sha256(surface.vertices_m.tobytes() + surface.triangles.tobytes()).digest()
                if key not in known:
                    found = decompose(surface, limits)
                    known[key] = [part.vertices_m for part in found.parts], found.deviation
                local, own = known[key]
                deviation = Deviation(
                    max(deviation.outside_m, own.outside_m), max(deviation.uncovered_m, own.uncovered_m)
                )
            else:
                local = [primitive_points(shape.geometry)]
            parts += [ConvexPart(points @ shape.placement.rotation.T + shape.placement.translation) for points in local]
        yield link, LinkParts(tuple(parts), deviation, sum(shape.mesh is not None for shape in of_link))


def surface_of(link: str, mesh: coal.BVHModelBase) -> Surface:
    """Return the triangles of a link's mesh; AssistantError where it has none, or too many."""
    if not 0 < mesh.num_tris <= MAX_TRIANGLES:
        raise AssistantError(
            f"a mesh of the link {link!r} has {mesh.num_tris} triangles, from 1 to {MAX_TRIANGLES} are allowed:"
            " simplify it, in Blender by the modifier Decimate"
        )
    return merged(*joined([(mesh, pin.SE3.Identity())]))


def primitive_points(shape: coal.CollisionGeometry) -> Vector:
    """Return points whose hull encloses a box, cylinder, sphere or any other simple shape, shape (n, 3) [m]."""
    if isinstance(shape, coal.Cylinder):
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        radius_m = shape.radius / np.cos(np.pi / SIDES)
        ring = radius_m * np.column_stack((np.cos(angles), np.sin(angles)))
        return np.vstack(
            [np.column_stack((ring, np.full(SIDES, end))) for end in (-shape.halfLength, shape.halfLength)]
        )
    if isinstance(shape, coal.Sphere | coal.Capsule):
        half_m = shape.halfLength if isinstance(shape, coal.Capsule) else 0.0
        ball = shape.radius * evenly_spread(SPHERE_POINTS)
        ends = np.vstack([ball + np.array([0.0, 0.0, end]) for end in (-half_m, half_m)])
        return ConvexPart(ends).within(evenly_spread(SPHERE_DIRECTIONS)).vertices_m
    if isinstance(shape, coal.Box):
        of_box: Vector = np.array(list(product((-1.0, 1.0), repeat=3))) * shape.halfSide
        return of_box
    return corners(shape)


def parts_in_link(link: str, parts: LinkParts) -> Parts:
    """Return a link's convex parts as the contact checks take them."""
    return parts_of(
        [pin.GeometryObject(link, 0, 0, pin.SE3.Identity(), convex(part.vertices_m)) for part in parts.parts]
    )


def shapes_in_link(link: str, shapes: list[LinkShape]) -> Parts:
    """Return a link's shapes as they are as the contact checks take them."""
    return parts_of([pin.GeometryObject(link, 0, 0, shape.placement, shape.geometry) for shape in shapes])


USAGE = "usage: python -m planners.assistant.link_shapes URDF SRDF FILE"


def link_surfaces(robot: RobotModel) -> dict[str, NDArray[Any]]:
    """Return the arrays of the file for an arm with the meshes that its URDF names; links without meshes have none."""
    arrays: dict[str, NDArray[Any]] = {}
    for link, shapes in link_shapes(robot).items():
        meshes = [(shape.mesh, shape.placement) for shape in shapes if shape.mesh is not None]
        if meshes:
            arrays[f"{link}.vertices"], arrays[f"{link}.triangles"] = packed(*joined(meshes))
    return arrays


def main() -> None:
    """Write the file."""
    if len(sys.argv) != 4:
        sys.exit(USAGE)
    urdf, srdf, path = map(Path, sys.argv[1:])
    arrays: dict[str, Any] = link_surfaces(model.load(urdf, srdf))
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    main()
