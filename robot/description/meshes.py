"""Mesh files of a URDF.

A mesh ``package://NAME/meshes/base.stl`` is sought below the package folders and the folders around the URDF: in a
folder NAME there, and in the folder itself where it is the package (the standard layouts of ROS).
"""

import logging
import os
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from robot.description.urdf import parsed
from robot.errors import DescriptionError

log = logging.getLogger("armbridge.description")

# Two million triangles and their vertices; the surfaces of the SO-101 have 6 MB.
MAX_SURFACES_BYTES = 50_000_000

# A million triangles of binary STL, which take 0.7 GB and 6 s to load.
MAX_MESH_BYTES = 50_000_000

_PACKAGE = "package://"
_FILE = "file://"

# The URDF of a package is in its folder urdf or robots, or one below it; the packages of a repository are side by side.
_FOLDERS_AROUND = 4


def package_path(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Return the folders of packages that ``ROS_PACKAGE_PATH`` of ROS 1 and ``AMENT_PREFIX_PATH`` of ROS 2 name."""
    folders = [Path(each) for each in environment.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if each]
    prefixes = [Path(each) for each in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    return (*folders, *(prefix / "share" for prefix in prefixes))


def find_mesh(name: str, directory: Path | None, packages: Sequence[Path]) -> Path:
    """Find the file of a mesh, a URL or a path beside the URDF; the error names the paths that were tried."""
    tried = list(dict.fromkeys(_candidates(name, directory, packages)))
    found = next((path for path in tried if path.is_file()), None)
    if found is not None and (size_bytes := found.stat().st_size) > MAX_MESH_BYTES:
        text = f"has {size_bytes} bytes, {MAX_MESH_BYTES} are allowed: simplify it, in Blender by the modifier Decimate"
        raise DescriptionError(f"mesh {found}", text)
    if found is not None:
        return found.resolve()
    places = ", ".join(map(str, tried)) or "nothing, for the URDF has no folder"
    remedy = "correct the name"
    if name.startswith(_PACKAGE):
        package = name.removeprefix(_PACKAGE).partition("/")[0]
        remedy = f"give the folder that contains the package {package!r}, with --package-path or ROS_PACKAGE_PATH"
    raise DescriptionError(f"mesh {name!r}", f"is not there: {remedy}; tried: {places}")


@contextmanager
def surface_file(path: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """Open a file of the links' surfaces, whose arrays are read when they are asked for.

    Raises DescriptionError for a file that cannot be read, that lacks an array, or that is too large when unpacked.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size_bytes = sum(each.file_size for each in archive.infolist())
        if size_bytes <= MAX_SURFACES_BYTES:
            with np.load(path, allow_pickle=False) as arrays:
                yield arrays
            return
    # An array's header may ask for any amount of memory.
    except (OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise DescriptionError(str(path), f"cannot be read: {error}") from error
    raise DescriptionError(str(path), f"unpacks to {size_bytes} bytes, {MAX_SURFACES_BYTES} are allowed")


def check_meshes(urdf: str, source: str, directory: Path, packages: Sequence[Path]) -> None:
    """Check that the meshes of collisions are there; missing visual meshes are logged."""
    unseen = []
    for link in parsed(urdf).iterfind("link"):
        for use in ("collision", "visual"):
            for mesh in _meshes(link.iterfind(use)):
                try:
                    find_mesh(mesh.get("filename", ""), directory, packages)
                except DescriptionError as error:
                    if use == "collision":
                        raise DescriptionError(f"{source} link {link.get('name')!r} <collision>", str(error)) from error
                    unseen.append(error)
    if unseen:
        log.warning("%s: %d meshes of <visual> will not be seen; the first: %s", source, len(unseen), unseen[0])


def with_mesh_paths(urdf: str, directory: Path | None, packages: Sequence[Path]) -> str:
    """Return a URDF whose collision meshes have their paths for names."""
    root = parsed(urdf)
    for mesh in _meshes(root.iterfind("link/collision")):
        mesh.set("filename", str(find_mesh(mesh.get("filename", ""), directory, packages)))
    return ET.tostring(root, encoding="unicode")


def _meshes(shapes: Iterable[ET.Element]) -> Iterator[ET.Element]:
    for shape in shapes:
        yield from shape.iterfind("geometry/mesh")


def _candidates(name: str, directory: Path | None, packages: Sequence[Path]) -> Iterator[Path]:
    if name.startswith(_PACKAGE):
        package, _, inner = name.removeprefix(_PACKAGE).partition("/")
        around = () if directory is None else (directory, *directory.parents)[:_FOLDERS_AROUND]
        for folder in (*packages, *around):
            # The folder contains the package, or is it.
            yield folder / package / inner
            if folder.name == package or _name_of_package(folder) == package:
                yield folder / inner
    elif name.startswith(_FILE):
        yield Path(unquote(name.removeprefix(_FILE)))
    elif directory is not None:
        yield directory / name
    elif Path(name).is_absolute():
        yield Path(name)


def _name_of_package(folder: Path) -> str | None:
    try:
        return ET.fromstring((folder / "package.xml").read_text(encoding="utf-8")).findtext("name")  # noqa: S314 - the user's
    except (OSError, UnicodeDecodeError, ET.ParseError):
        return None
