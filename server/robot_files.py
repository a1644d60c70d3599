"""Files that the robot's description names, as clients may fetch them."""

import contextlib
import re
import xml.etree.ElementTree as ET
from functools import cached_property
from pathlib import Path

from robot.description.meshes import find_mesh
from robot.description.model import RobotModel
from robot.errors import DescriptionError
from server.errors import FileTooLargeError, ServiceError

# A mesh of a million triangles is 50 MB; a link's has a thousandth of it. Base64 makes it a third more on the wire.
MAX_FILE_BYTES = 20 << 20

# Meshes and their textures. A URDF may be in a user's home, and every client of the port can read the served files.
SUFFIXES = frozenset(
    (".stl", ".dae", ".obj", ".mtl", ".ply", ".gltf", ".glb", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif")
)

_PACKAGE = "package://"
_SCHEME = re.compile(r"^[a-z][a-z0-9+.-]*://")


class RobotFiles:
    """Files that clients may fetch: those below the URDF's folder, and those beside the meshes of its packages."""

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._package = package_name(robot)

    def find(self, name: str) -> Path:
        """Find a file by its ``package://`` URL or its path within the URDF's folder, or raise ServiceError."""
        for url, folder in self._mesh_folders.items():
            if name.startswith(f"{url}/"):
                return _checked(folder, name.removeprefix(f"{url}/"), name, f"{url}/")
        directory = self._robot.mesh_directory
        if directory is None:
            raise ServiceError(f"name: {name!r} is not here: this robot's description names no files")
        return _checked(
            directory, _within(directory.resolve(), self._package, name), name, f"{_PACKAGE}{self._package}/"
        )

    @cached_property
    def _mesh_folders(self) -> dict[str, Path]:
        """The folders of meshes that the URDF names by package URLs, by their own URL."""
        folders: dict[str, Path] = {}
        root = ET.fromstring(self._robot.urdf)  # noqa: S314 - the user's own file, already parsed
        for name in {mesh.get("filename", "") for mesh in root.iter("mesh")}:
            if name.startswith(_PACKAGE):
                # Visual meshes may be missing: the start has logged them.
                with contextlib.suppress(DescriptionError):
                    found = find_mesh(name, self._robot.mesh_directory, self._robot.package_directories)
                    folders[name.rpartition("/")[0]] = found.parent
        return folders


def package_name(robot: RobotModel) -> str:
    """Return the name of the package under which the robot's files are served, in the style of ROS packages."""
    return f"{re.sub(r'[^a-z0-9_]+', '_', robot.name.lower())}_description"


def with_package_urls(robot: RobotModel) -> str:
    """Return the URDF with a package URL in place of every mesh path, such as ``assets/base.stl``."""
    root = ET.fromstring(robot.urdf)  # noqa: S314 - the user's own file, already parsed by robot.description.model
    meshes = [mesh for mesh in root.iter("mesh") if not _SCHEME.match(mesh.get("filename", ""))]
    if not meshes:
        return robot.urdf
    for mesh in meshes:
        mesh.set("filename", f"{_PACKAGE}{package_name(robot)}/{mesh.get('filename', '').removeprefix('./')}")
    return ET.tostring(root, encoding="unicode")


def file_below(directory: Path, inner: str, shown: str, where: str, max_bytes: int) -> Path:
    """Return the file at a path within a directory, which no link may leave.

    Raises ServiceError for a missing file, and FileTooLargeError; ``shown`` and ``where`` name it in their sentences.
    """
    nowhere = f"{shown} is no file {where}"
    try:
        root = directory.resolve()
        path = (root / inner).resolve()
        if not path.is_relative_to(root) or not path.is_file():
            raise ServiceError(nowhere)
        size_bytes = path.stat().st_size
    # A name with a zero byte is no name of a file.
    except (OSError, ValueError) as error:
        raise ServiceError(f"{nowhere}: {error}") from error
    if size_bytes > max_bytes:
        raise FileTooLargeError(f"{shown} has {size_bytes} bytes, the limit is {max_bytes}")
    return path


def _checked(directory: Path, inner: str, name: str, url: str) -> Path:
    shown, where = f"name: {name!r}", f"below {url}"
    path = file_below(directory, inner, shown, where, MAX_FILE_BYTES)
    # Programs have hidden folders in a user's home.
    if any(part.startswith(".") for part in path.relative_to(directory.resolve()).parts):
        raise ServiceError(f"{shown} is no file {where}")
    if path.suffix.lower() not in SUFFIXES:
        raise ServiceError(f"name: {name!r} is neither mesh nor texture: those end in {', '.join(sorted(SUFFIXES))}")
    return path


def _within(root: Path, package: str, name: str) -> str:
    if not name.startswith(_PACKAGE):
        return name
    inner = name.removeprefix(_PACKAGE)
    own, _, rest = inner.partition("/")
    # A folder named like its package comes before the package itself.
    return rest if own in (package, root.name) and not (root / own).is_dir() else inner
