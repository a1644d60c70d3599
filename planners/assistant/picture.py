"""Picture of a robot's meshes beside their convex parts, from two sides.

Surfaces are drawn as many points, and a pixel shows the nearest: time and memory do not depend on the triangles.
"""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from planners.assistant.surface import Surface, sample_with_normals
from robot.trajectory import Vector

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


def draw(
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
    scale = SIZE * (1.0 - 2.0 * MARGIN) / max(size_m, 1e-9)
    seen = points - middle
    columns = np.clip((0.5 * SIZE + scale * (seen @ right)).astype(int), 0, SIZE - 1)
    rows = np.clip((0.5 * SIZE - scale * (seen @ up)).astype(int), 0, SIZE - 1)
    # Later ones replace earlier ones: the nearest last.
    order = np.argsort(seen @ towards, kind="stable")
    # Meshes in circulation have triangles that are turned inside out: both sides are lit.
    facing = np.where((normals @ towards < 0.0)[:, np.newaxis], -normals, normals)
    light = 0.45 + 0.55 * np.clip(facing @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    pixels = np.full((SIZE, SIZE, 3), 255, dtype=np.uint8)
    pixels[rows[order], columns[order]] = (255.0 * colours * light[:, np.newaxis])[order].astype(np.uint8)
    return pixels
