"""Surfaces of an arm's links, from the meshes of its URDF.

Written by ``python -m planners.assistant.link_surfaces URDF SRDF FILE``, for ``robot.surfaces`` of a ``robot.toml``:
the surface of a link decides if a point is inside it.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.assistant.link_shapes import link_shapes
from planners.geometry.surfaces import joined, packed
from robot.description import model
from robot.description.model import RobotModel

USAGE = "usage: python -m planners.assistant.link_surfaces URDF SRDF FILE"


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
