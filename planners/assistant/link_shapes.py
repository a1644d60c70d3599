"""Collision shapes of a URDF's links in the frames of the links, with their convex parts, surfaces, and a picture.

``python -m planners.assistant.link_shapes URDF SRDF FILE`` writes the surfaces, for ``robot.surfaces`` of a
``robot.toml``: the surface of a link decides if a point is inside it.
"""

from __future__ import annotations

import colorsys
import hashlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from planners.assistant.decomposition import MAX_TRIANGLES, Limits, decompose
from planners.assistant.surface import ConvexPart, Deviation, Surface, merged, sample_with_normals
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
        ends_m = (-shape.halfLength, shape.halfLength)
        return np.vstack([np.column_stack((ring, np.full(SIDES, end_m))) for end_m in ends_m])
    if isinstance(shape, coal.Sphere | coal.Capsule):
        half_m = shape.halfLength if isinstance(shape, coal.Capsule) else 0.0
        ball = shape.radius * evenly_spread(SPHERE_POINTS)
        ends = np.vstack([ball + np.array([0.0, 0.0, end]) for end in (-half_m, half_m)])
        return ConvexPart(ends).within(evenly_spread(SPHERE_DIRECTIONS)).vertices_m
    if isinstance(shape, coal.Box):
        return np.asarray(np.array(list(product((-1.0, 1.0), repeat=3))) * shape.halfSide)
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


# Pixels of each of the four views, and points of each robot in one.
SIZE = 620
POINTS = 900_000
MARGIN = 0.06

BACKGROUND = (255, 255, 255)
TEXT = (60, 60, 60)

# Directions that are seen to the right and upwards: obliquely from the front, and from the side.
VIEWS = (
    (np.array([-0.64, 0.77, 0.0]), np.array([-0.31, -0.26, 0.91])),
    (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
)
LIGHT = np.array([0.5, -0.4, 0.77])

HUE_STEP = 0.618034  # a turn of the colour wheel by the golden ratio keeps neighbours apart


def draw_picture(
    path: Path,
    meshes: Mapping[str, Sequence[Surface]],
    parts: Mapping[str, Sequence[Surface]],
    placements: Mapping[str, pin.SE3],
) -> None:
    """Write a picture as PNG of surfaces in the frames of their links, whose poses are ``placements``."""
    whole = Image.new("RGB", (2 * SIZE, len(VIEWS) * SIZE), BACKGROUND)
    clouds = [_cloud(surfaces, placements, by_part) for surfaces, by_part in ((meshes, False), (parts, True))]
    lower = np.min([cloud[0].min(axis=0) for cloud in clouds], axis=0)
    upper = np.max([cloud[0].max(axis=0) for cloud in clouds], axis=0)
    for row, (right, up) in enumerate(VIEWS):
        for column, cloud in enumerate(clouds):
            view = _view(*cloud, right, up, 0.5 * (lower + upper), float(np.linalg.norm(upper - lower)))
            whole.paste(Image.fromarray(view), (column * SIZE, row * SIZE))
    pen = ImageDraw.Draw(whole)
    pen.text((12, 10), "collision shapes of the URDF, a colour a link", fill=TEXT)
    pen.text((SIZE + 12, 10), "convex parts, a colour a part", fill=TEXT)
    whole.save(path, format="PNG", optimize=True)


def _cloud(
    links: Mapping[str, Sequence[Surface]], placements: Mapping[str, pin.SE3], by_part: bool
) -> tuple[Vector, Vector, Vector]:
    """Return points [m], unit normals and colours of surfaces, shape (n, 3) each."""
    random = np.random.default_rng(0)
    surfaces = [(link, surface) for link, each in links.items() for surface in each]
    total = sum(surface.area_m2 for _, surface in surfaces)
    names = list(links)
    points, normals, colours = [], [], []
    for index, (link, surface) in enumerate(surfaces):
        count = max(1, int(POINTS * surface.area_m2 / total)) if total > 0.0 else 1
        at = placements[link]
        own, across = sample_with_normals(surface, count, random)
        points.append(own @ at.rotation.T + at.translation)
        normals.append(across @ at.rotation.T)
        hue = (index if by_part else names.index(link)) * HUE_STEP % 1.0
        colours.append(np.tile(colorsys.hsv_to_rgb(hue, 0.45, 0.95), (count, 1)))
    return np.vstack(points), np.vstack(normals), np.vstack(colours)


def _view(
    points: Vector, normals: Vector, colours: Vector, right: Vector, up: Vector, middle: Vector, size_m: float
) -> NDArray[np.uint8]:
    right, up = right / np.linalg.norm(right), up / np.linalg.norm(up)
    towards = np.cross(right, up)
    size_m = max(size_m, 1e-9)
    scale = SIZE * (1.0 - 2.0 * MARGIN) / size_m
    seen = points - middle
    columns, rows = (np.clip((0.5 * SIZE + scale * (seen @ to)).astype(int), 0, SIZE - 1) for to in (right, -up))
    # Later ones replace earlier ones: the nearest last. Numbers of 16 bits are sorted many times as fast.
    order = np.argsort(((seen @ towards / size_m + 0.5) * 65535.0).astype(np.uint16), kind="stable")
    nearest = np.full((SIZE, SIZE), -1)
    nearest[rows[order], columns[order]] = order
    drawn = nearest >= 0
    chosen = nearest[drawn]
    # Meshes in circulation have triangles that are turned inside out: both sides are lit.
    facing = np.copysign(1.0, normals[chosen] @ towards) * (normals[chosen] @ (LIGHT / np.linalg.norm(LIGHT)))
    pixels = np.full((SIZE, SIZE, 3), 255, dtype=np.uint8)
    pixels[drawn] = 255.0 * colours[chosen] * (0.45 + 0.55 * np.clip(facing, 0.0, 1.0))[:, np.newaxis]
    return pixels


def main() -> None:
    """Write the file."""
    if len(sys.argv) != 4:
        sys.exit(USAGE)
    urdf, srdf, path = map(Path, sys.argv[1:])
    arrays: dict[str, Any] = link_surfaces(model.load(urdf, srdf))
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    main()
