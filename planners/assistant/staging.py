"""Copy of a URDF and of its meshes in one folder, so that the folder can be moved and served as a whole."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from planners.errors import AssistantError
from robot.description.mesh_files import find_mesh
from robot.description.urdf import root_of

MESHES = "meshes"

# Size of the meshes of one robot: twenty times the SO-101's.
MAX_MESH_BYTES = 500 << 20


def parse_urdf(urdf_path: Path) -> ET.Element:
    """Read a URDF; AssistantError for a file that cannot be read, DescriptionError for one that is no URDF."""
    try:
        text = urdf_path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssistantError(f"{urdf_path} cannot be read: {error}") from error
    return root_of(text, str(urdf_path))


def copy_meshes(root: ET.Element, urdf_path: Path, packages: Sequence[Path], folder: Path) -> int:
    """Copy the meshes of a URDF into a folder, name the copies in ``root``, and return the number of meshes.

    DescriptionError: a mesh of a <collision> is missing; the text has the paths that were tried. AssistantError: the
    meshes are too large.
    """
    names: dict[Path, str] = {}
    total_bytes = 0
    for link in root.iterfind("link"):
        for shape in [*link.findall("collision"), *link.findall("visual")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            source = _source(mesh, shape, urdf_path, packages)
            if source is None:
                link.remove(shape)
                continue
            if source not in names:
                total_bytes += source.stat().st_size
                if total_bytes > MAX_MESH_BYTES:
                    raise AssistantError(
                        f"the meshes of {urdf_path} have more than {MAX_MESH_BYTES >> 20} MiB: simplify them"
                    )
                names[source] = _free_name(source, set(names.values()))
                (folder / MESHES).mkdir(exist_ok=True)
                shutil.copyfile(source, folder / MESHES / names[source])
                # An OBJ file names its materials by their file.
                material = source.with_suffix(".mtl")
                if source.suffix.lower() == ".obj" and material.is_file():
                    shutil.copyfile(material, folder / MESHES / material.name)
            mesh.set("filename", f"{MESHES}/{names[source]}")
    return len(names)


def _source(mesh: ET.Element, shape: ET.Element, urdf_path: Path, packages: Sequence[Path]) -> Path | None:
    """Return the file of a mesh; None for a visual mesh that does not exist."""
    try:
        return find_mesh(mesh.get("filename", ""), urdf_path.resolve().parent, packages)
    except Exception:
        if shape.tag == "visual":
            return None
        raise


def _free_name(source: Path, taken: set[str]) -> str:
    """Return a name in the folder of meshes: the file's, with its folder's in front where that is taken."""
    name, number = source.name, 1
    if name in taken:
        name = f"{source.parent.name}_{source.name}"
    while name in taken:
        number += 1
        name = f"{source.parent.name}_{number}_{source.name}"
    return name
