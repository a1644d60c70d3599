"""The robot's files as clients load them: its URDF, and the meshes and textures that the URDF names.

One set of rules for whoever asks, by the service ``/file_server/get_file`` or by HTTP below ``/robot/``.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from robot.description.model import RobotModel
from server.errors import FileTooLargeError, ServiceError

# A mesh of a million triangles is 50 MB; a link's has a thousandth of it. Base64 makes it a third more on the wire.
MAX_FILE_BYTES = 20 << 20

# Meshes and their textures. A URDF may lie in somebody's home, and whoever reaches the port reads what is served.
SUFFIXES = frozenset(
    (".stl", ".dae", ".obj", ".mtl", ".ply", ".gltf", ".glb", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif")
)

_PACKAGE = "package://"
_SCHEME = re.compile(r"^[a-z][a-z0-9+.-]*://")


def package_name(robot: RobotModel) -> str:
    """Name of the package under which the robot's files are served, as ROS packages are named."""
    return f"{re.sub(r'[^a-z0-9_]+', '_', robot.name.lower())}_description"


def with_package_urls(urdf: str, package: str) -> str:
    """The URDF with every mesh that is named by a path, such as ``assets/base.stl``, named by a package URL instead.

    Args:
        urdf: the text.
        package: whose files they are said to be.
    """
    root = ET.fromstring(urdf)  # noqa: S314 - the user's own file, already parsed by robot.description.model
    meshes = [mesh for mesh in root.iter("mesh") if not _SCHEME.match(mesh.get("filename", ""))]
    if not meshes:
        return urdf
    for mesh in meshes:
        mesh.set("filename", f"{_PACKAGE}{package}/{mesh.get('filename', '').removeprefix('./')}")
    return ET.tostring(root, encoding="unicode")


def find_file(directory: Path | None, package: str, name: str) -> Path:
    """Where one of the robot's files is.

    Args:
        directory: that of the URDF; nothing outside it is served.
        package: the name in package URLs; the directory's own name does as well, as it does for the planners.
        name: a ``package://`` URL, or a path within the directory.

    Raises:
        ServiceError: no such file, one of another kind, or one outside the directory.
        FileTooLargeError: it is too large.
    """
    if directory is None:
        raise ServiceError(f"name: {name!r} is not here: this robot's description names no files")
    nowhere = f"name: {name!r} is no file below {_PACKAGE}{package}/"
    try:
        root = directory.resolve()
        inner = _within(root, package, name)
        path = (root / inner).resolve()
        # Whatever the name says, links included, the file must be where the description is.
        if not path.is_relative_to(root) or _hidden(path.relative_to(root)) or not path.is_file():
            raise ServiceError(nowhere)
        size_bytes = path.stat().st_size
    # A name with a zero byte is no name of a file.
    except (OSError, ValueError) as error:
        raise ServiceError(f"{nowhere}: {error}") from error
    if path.suffix.lower() not in SUFFIXES:
        raise ServiceError(f"name: {name!r} is neither mesh nor texture: those end in {', '.join(sorted(SUFFIXES))}")
    if size_bytes > MAX_FILE_BYTES:
        raise FileTooLargeError(f"name: {name!r} has {size_bytes} bytes, the limit is {MAX_FILE_BYTES}")
    return path


def read_file(directory: Path | None, package: str, name: str) -> bytes:
    """Read one of the robot's files; arguments and errors are those of :func:`find_file`."""
    path = find_file(directory, package, name)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ServiceError(f"name: {name!r} cannot be read: {error.strerror}") from error


def _hidden(path: Path) -> bool:
    """Whether a file or a folder above it is hidden, as those of programs in somebody's home."""
    return any(part.startswith(".") for part in path.parts)


def _within(root: Path, package: str, name: str) -> str:
    """The path below the directory that a name means."""
    if not name.startswith(_PACKAGE):
        return name
    inner = name.removeprefix(_PACKAGE)
    own, _, rest = inner.partition("/")
    # A folder named like its package comes before the package itself.
    return rest if own in (package, root.name) and not (root / own).is_dir() else inner
