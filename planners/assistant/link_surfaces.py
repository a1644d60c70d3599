"""Surfaces of an arm's links, from the meshes of its URDF.

Written by ``python -m planners.assistant.link_surfaces URDF SRDF FILE``.

The file is what ``robot.surfaces`` of a ``robot.toml`` names: where the parts of a link are too wide to tell whether it
touches something, its surface decides.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.plain_urdf import kinematic_urdf
from planners.geometry.shapes import link_name, urdf_shapes
from planners.geometry.surfaces import packed
from robot.description import model
from robot.description.model import RobotModel
from robot.trajectory import Vector

USAGE = "usage: python -m planners.assistant.link_surfaces URDF SRDF FILE"


def link_surfaces(robot: RobotModel) -> dict[str, NDArray[Any]]:
    """Return the arrays of the file; links without meshes have none.

    Args:
        robot: the arm, with the meshes that its URDF names.

    Raises:
        ShapeError: a mesh cannot be loaded.
    """
    pin_model = pin.buildModelFromXML(kinematic_urdf(robot))
    meshes: dict[str, list[tuple[Vector, NDArray[np.int64]]]] = {}
    for shape in urdf_shapes(robot, pin_model):
        if not isinstance(shape.geometry, coal.BVHModelBase):
            continue
        place = pin_model.frames[shape.parentFrame].placement.inverse() * shape.placement
        vertices_m = np.asarray(shape.geometry.vertices()) @ place.rotation.T + place.translation
        numbers = (shape.geometry.tri_indices(i) for i in range(shape.geometry.num_tris))
        triangles = np.array([(each[0], each[1], each[2]) for each in numbers])
        meshes.setdefault(link_name(pin_model, shape), []).append((vertices_m, triangles))
    arrays: dict[str, NDArray[Any]] = {}
    for link, parts in meshes.items():
        before = np.cumsum([0, *(len(vertices_m) for vertices_m, _ in parts)])
        triangles = np.vstack([each + shift for (_, each), shift in zip(parts, before, strict=False)])
        arrays[f"{link}.vertices"], arrays[f"{link}.triangles"] = packed(
            np.vstack([each for each, _ in parts]), triangles
        )
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
