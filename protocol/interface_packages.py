"""ROS packages of the user: their ``msg``, ``srv`` and ``action`` files become tables beside the packaged ones.

A folder is a package, or has packages in it at any depth, as a workspace's ``src`` and an install's ``share`` have.
All problems of all files are reported at once.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import get_args

from protocol.errors import InterfaceFilesError
from protocol.interface_files import NAME, Flaw, Generation, InterfaceFile, is_spelled_as_ros1, read_file
from protocol.registry import (
    Definition,
    Kind,
    Registry,
    Table,
    read_ros1,
    read_ros2,
    with_action_messages,
)

# Of a workspace: repositories in folders of their own, with packages in folders of their own.
MAX_DEPTH = 6

_KINDS: tuple[Kind, ...] = get_args(Kind)

# Folders of a kind's files: CMakeLists.txt may name any, as tf2_web_republisher's names `services`.
_FOLDERS: Mapping[Kind, tuple[str, ...]] = {
    "msg": ("msg", "msgs", "messages"),
    "srv": ("srv", "srvs", "services"),
    "action": ("action", "actions"),
}

# Tools leave folders with one of these files alone (colcon, catkin, ament).
_IGNORE_MARKERS = frozenset(("COLCON_IGNORE", "CATKIN_IGNORE", "AMENT_IGNORE"))


@dataclass(frozen=True)
class UserInterfaces:
    """Types of the user's packages.

    Attributes:
        known: names of types that are packaged, which stay as they are: the program itself uses most of them.
        unread: interface files in folders of packages that are not read.
    """

    ros2: Table
    ros1: Table
    packages: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    unread: tuple[Path, ...] = ()

    def registry(self) -> Registry:
        return Registry({**read_ros2(), **self.ros2}, {**read_ros1(), **self.ros1})


@dataclass
class _Package:
    folder: Path
    name: str
    generation: Generation | None
    texts: list[tuple[Kind, Path, str]] = field(default_factory=list)


def read_packages(folders: Sequence[Path]) -> UserInterfaces:
    """Read the interface files of packages, or raise InterfaceFilesError with all problems."""
    reader = _PackageReader()
    packages = [package for folder in folders for package in reader.read_folder(folder)]
    files: dict[Generation, list[InterfaceFile]] = {"ros1": [], "ros2": []}
    for package in packages:
        generation = package.generation or "ros2"
        files[generation] += (
            read_file(path, text, package.name, kind, generation) for kind, path, text in package.texts
        )
    problems = reader.problems + [problem for each in files.values() for file in each for problem in file.problems]
    if problems:
        raise InterfaceFilesError(problems)
    tables = {generation: _table(each, problems) for generation, each in files.items()}
    merged = _merged(tables)
    registry = merged.registry()
    for generation, chosen in (("ros2", registry), ("ros1", registry.ros1)):
        problems += _unknown_types(files[generation], chosen)
    if not problems:
        problems += [*_circles(files["ros2"], registry), *_circles(files["ros1"], registry.ros1)]
    if problems:
        raise InterfaceFilesError(problems)
    return replace(merged, unread=tuple(path for package in packages for path in _unread_files(package.folder)))


class _PackageReader:
    """Finds packages and reads their files."""

    def __init__(self) -> None:
        self.problems: list[Flaw] = []
        # Real paths of the folders that were read: symbolic links may lead in a circle.
        self._seen: set[Path] = set()

    def read_folder(self, folder: Path) -> list[_Package]:
        if not folder.is_dir():
            self._refuse(folder, "wanted a folder with ROS packages, and there is none")
            return []
        self._seen.clear()
        found = [self._read_package(each) for each in self._packages(folder, MAX_DEPTH)]
        packages = [package for package in found if package is not None]
        if not packages and not self.problems:
            self._refuse(folder, "no package in it has msg/*.msg, srv/*.srv or action/*.action files")
        # Packages without a stated generation have one author, who writes for one of the two.
        unknown = [package for package in packages if package.generation is None]
        generation: Generation = "ros1" if any(map(_is_spelled_as_ros1, unknown)) else "ros2"
        for package in unknown:
            package.generation = generation
        return packages

    def _packages(self, folder: Path, depth: int) -> Iterator[Path]:
        """Go over the folders that are packages; there are no packages inside of packages."""
        if (place := folder.resolve()) in self._seen:
            return
        self._seen.add(place)
        try:
            names = sorted(each.name for each in folder.iterdir())
        except OSError as error:
            self._refuse(folder, f"cannot be read: {error.strerror}")
            return
        if not _IGNORE_MARKERS.isdisjoint(names):
            return
        if "package.xml" in names or any(_interface_files(folder, kind) for kind in _KINDS):
            yield folder
        elif depth:
            for name in names:
                if not name.startswith(".") and (folder / name).is_dir():
                    yield from self._packages(folder / name, depth - 1)

    def _read_package(self, folder: Path) -> _Package | None:
        paths = [(kind, path) for kind in _KINDS for path in _interface_files(folder, kind)]
        if not paths:
            return None
        name, generation = self._identity(folder)
        texts = [(kind, path, text) for kind, path in paths if (text := self._text(path)) is not None]
        return _Package(folder, name, generation, texts)

    def _identity(self, folder: Path) -> tuple[str, Generation | None]:
        """Return name and generation by package.xml, else the folder's name and None."""
        manifest = folder / "package.xml"
        # Resolved, for the folder may be given as `.`
        name, generation = folder.resolve().name, None
        if manifest.is_file() and (text := self._text(manifest)) is not None:
            try:
                root = ET.fromstring(text)  # noqa: S314 - the user's own file, given on the command line
            except (ET.ParseError, ValueError) as error:
                line = error.position[0] if isinstance(error, ET.ParseError) else None
                self.problems.append(Flaw(manifest, line, "", f"is no XML: {error}"))
                return name, None
            name = (root.findtext("name") or name).strip()
            generation = _generation(root)
        if not NAME.fullmatch(name):
            place = manifest if manifest.is_file() else folder
            sentence = "wanted a package's name of letters, digits and underscores"
            self.problems.append(Flaw(place, None, name, sentence))
        return name, generation

    def _text(self, path: Path) -> str | None:
        try:
            # Older packages have comments in other encodings, which are of no interest.
            return path.read_text("utf-8", "replace")
        except OSError as error:
            self._refuse(path, f"cannot be read: {error.strerror}")
            return None

    def _refuse(self, path: Path, sentence: str) -> None:
        self.problems.append(Flaw(path, None, "", sentence))


def _interface_files(folder: Path, kind: Kind) -> list[Path]:
    """Return the files of a kind; of those that builds install beside them, none."""
    return sorted(path for name in _FOLDERS[kind] for path in (folder / name).glob(f"*.{kind}") if path.is_file())


def _unread_files(folder: Path) -> list[Path]:
    read = {name for names in _FOLDERS.values() for name in names}
    files = (path for kind in _KINDS for path in folder.glob(f"*/*.{kind}"))
    return sorted(path for path in files if path.parent.name not in read and path.is_file())


def _generation(manifest: ET.Element) -> Generation | None:
    """Return the generation by the build tool that a package.xml names; None where it is unclear."""
    tools = {(each.text or "").strip() for tag in ("buildtool_depend", "build_type") for each in manifest.iter(tag)}
    ros1 = any(tool.startswith("catkin") for tool in tools)
    ros2 = any(tool.startswith(("ament", "rosidl")) for tool in tools)
    if ros1 == ros2:
        return None
    return "ros1" if ros1 else "ros2"


def _is_spelled_as_ros1(package: _Package) -> bool:
    has_header = any(path.stem == "Header" for _, path, _ in package.texts)
    return any(is_spelled_as_ros1(text, has_header=has_header) for _, _, text in package.texts)


def _table(files: Iterable[InterfaceFile], problems: list[Flaw]) -> dict[str, Definition]:
    first: dict[str, InterfaceFile] = {}
    for file in files:
        other = first.setdefault(file.name, file)
        if other.definition != file.definition:
            sentence = f"defines {file.name} otherwise than {other.path} does; remove one of them"
            problems.append(Flaw(file.path, None, "", sentence))
    return {name: file.definition for name, file in first.items()}


def _merged(tables: Mapping[Generation, dict[str, Definition]]) -> UserInterfaces:
    """Return the types without those that are packaged."""
    packages = tuple(sorted({name.split("/")[0] for table in tables.values() for name in table}))
    user, packaged = (tables["ros2"], with_action_messages(tables["ros1"])), (read_ros2(), read_ros1())
    known = {name for table, own in zip(user, packaged, strict=True) for name in table if name in own}
    ros2, ros1 = (
        {name: definition for name, definition in table.items() if name not in own}
        for table, own in zip(user, packaged, strict=True)
    )
    return UserInterfaces(ros2, ros1, packages, tuple(sorted(known)))


def _unknown_types(files: Iterable[InterfaceFile], registry: Registry) -> Iterator[Flaw]:
    known: list[str] = []
    for file in files:
        for reference in file.references:
            name = reference.type_name
            if registry.knows(name):
                continue
            known = known or [_spell(each) for each in registry.type_names() if registry.knows(each)]
            # The right name in the wrong package, or in none, helps more than a similar one.
            suffix = f"/{name.split('/')[1]}"
            meant = [each for each in known if each.endswith(suffix)] or get_close_matches(name, known, n=1)
            hint = f"; did you mean {meant[0]}?" if meant else ""
            yield Flaw(file.path, reference.line, reference.text, f"type {name} is unknown{hint}")


def _circles(files: Iterable[InterfaceFile], registry: Registry) -> Iterator[Flaw]:
    """Return the files whose types contain themselves."""
    for file in files:
        members = [member.title() for member in file.definition if member != "kind"]
        is_message = file.definition["kind"] == "msg"
        names = [file.name] if is_message else [f"{file.name}_{member}" for member in members]
        circle = next(filter(None, (_circle(registry, name, (), set()) for name in names)), ())
        if circle:
            sentence = f"a type may not contain itself: {' contains '.join(map(_spell, circle))}"
            yield Flaw(file.path, None, "", sentence)


def _circle(registry: Registry, name: str, inside: tuple[str, ...], looked_at: set[str]) -> tuple[str, ...]:
    """Return the names along which a message type contains itself; none where it does not."""
    if name in inside:
        return (*inside[inside.index(name) :], name)
    if name in looked_at:
        return ()
    looked_at.add(name)
    bases = (each.base for each in registry.message(name).fields if not each.primitive)
    return next(filter(None, (_circle(registry, base, (*inside, name), looked_at) for base in bases)), ())


def _spell(name: str) -> str:
    first, *_, last = name.split("/")
    return f"{first}/{last}"
