"""ROS packages of the user: their ``msg``, ``srv`` and ``action`` files become tables beside the packaged ones.

A folder is a package, or has packages in it at any depth, as a workspace's ``src`` and an install's ``share`` have.
All problems of all files are reported at once.
"""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias, get_args

from protocol import values
from protocol.errors import InterfaceFilesError, MessageError, one_line, shorten
from protocol.registry import (
    PRIMITIVES,
    TEXTS,
    Definition,
    Kind,
    Registry,
    Scalar,
    Table,
    read_ros1,
    read_ros2,
    with_action_messages,
)

Generation: TypeAlias = Literal["ros1", "ros2"]

# Members of each kind, in the order in which the file has them, between lines of three dashes.
_MEMBERS: dict[Kind, tuple[str, ...]] = {
    "msg": ("",),
    "srv": ("request", "response"),
    "action": ("goal", "result", "feedback"),
}

# Of types, fields and constants, in either generation; builds of ROS 2 have narrower rules.
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NAME_WORDS = "a name of letters, digits and underscores"

# `pkg/Type`, `string<=20`, `float64[9]`, `Point[<=3]`
_TYPE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/[A-Za-z]\w*)?)(?:<=(?P<length>[0-9]+))?(?P<brackets>\[(?:(?:<=)?(?P<size>[0-9]+))?\])?",
    re.ASCII,
)
_TYPE_WORDS = "a type such as float64, float64[], float64[9], float64[<=9], string<=20, Point or geometry_msgs/Point"
_QUOTED = re.compile(r"\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'")
_DIVIDER = re.compile(r"\s*---\s*(?:#.*)?")
_LINE_BREAK = re.compile(r"\r\n|\r|\n")

# What only ROS 1 reads, where a package does not tell its generation.
_ROS1_LINE = re.compile(r"^[ \t]*(?:(?P<time>time|duration)|Header)(?:\[[0-9]*\])?[ \t]+[A-Za-z]", re.MULTILINE)

_OLD_TIMES = ("time", "duration")

# The second is of ROS 1 before Fuerte.
_HEADERS_OF_ROS1 = frozenset(("Header", "roslib/Header"))


class Flaw(NamedTuple):
    """One problem of the interface files; ``line`` counts from 1, None for the whole file."""

    path: Path
    line: int | None
    text: str
    sentence: str

    def __str__(self) -> str:
        place = str(self.path) if self.line is None else f"{self.path}:{self.line}"
        shown = f" {one_line(shorten(self.text.strip()))!r}:" if self.text.strip() else ""
        return f"{place}:{shown} {self.sentence}"


class Reference(NamedTuple):
    """A message type that a file refers to, and its line."""

    type_name: str
    line: int
    text: str


@dataclass
class InterfaceFile:
    """Readable contents of one interface file."""

    name: str
    path: Path
    definition: Definition = field(default_factory=dict)
    references: list[Reference] = field(default_factory=list)
    problems: list[Flaw] = field(default_factory=list)


def is_spelled_as_ros1(text: str, *, has_header: bool) -> bool:
    """Return True for a file that only ROS 1 reads: with ``time``, ``duration``, or ``Header`` without a package."""
    return any(match["time"] or not has_header for match in _ROS1_LINE.finditer(text))


def read_file(path: Path, text: str, package: str, kind: Kind, generation: Generation) -> InterfaceFile:
    """Read an interface file."""
    read = InterfaceFile(f"{package}/{kind}/{path.stem}", path)
    if not NAME.fullmatch(path.stem):
        read.problems.append(Flaw(path, None, "", f"the file's name is the type's: wanted {_NAME_WORDS}"))
    lines = _LINE_BREAK.split(text.removeprefix("\N{BYTE ORDER MARK}"))
    members = [_Member(package, generation)]
    for number, line in enumerate(lines, 1):
        if kind != "msg" and _DIVIDER.fullmatch(line):
            members.append(_Member(package, generation))
            continue
        try:
            referred = members[-1].read(line)
        except ValueError as error:
            read.problems.append(Flaw(path, number, line, str(error)))
        else:
            if referred:
                read.references.append(Reference(referred, number, line))
    names = _MEMBERS[kind]
    if len(members) != len(names):
        sentence = f"wanted {len(names) - 1} of the lines --- between {', '.join(names)}, got {len(members) - 1}"
        read.problems.append(Flaw(path, None, "", sentence))
    rows = {name: {"fields": member.fields, "consts": member.constants} for name, member in zip(names, members)}  # noqa: B905
    read.definition = {"kind": kind, **(rows[""] if kind == "msg" else rows)}
    return read


class _Member:
    def __init__(self, package: str, generation: Generation) -> None:
        self.fields: list[list[str]] = []
        self.constants: list[list[str]] = []
        self._package = package
        self._generation = generation
        self._names: set[str] = set()

    def read(self, line: str) -> str:
        if not line.partition("#")[0].strip():
            return ""
        declared, rest = (*line.split(None, 1), "")[:2]
        if declared.startswith("---"):
            raise ValueError("a message is not divided; only services and actions have parts, with --- between them")
        name, value = re.fullmatch(r"([^\s=#]*)\s*(.*)", rest.strip(), re.DOTALL).groups()  # type: ignore[union-attr]
        if not name:
            raise ValueError("wanted a type, blanks and a name")
        if not NAME.fullmatch(name):
            raise ValueError(f"wanted {_NAME_WORDS}, got {name}")
        declaration = _read_type(declared, self._package, self._generation)
        if name in self._names:
            raise ValueError(f"the name {name} is declared twice")
        self._names.add(name)
        if value.startswith("="):
            raw = self._generation == "ros1" and declared == "string"
            # A text constant of ROS 1 is all that follows the sign, comments and quotes too (genmsg.msg_loader).
            text = value[1:].strip() if raw else _without_comment(value[1:].strip())
            self.constants.append([declaration.base, name, _constant(declaration, text, self._generation)])
            return ""
        text = _without_comment(value)
        default = [_default(declaration, text, self._generation)] if text else []
        self.fields.append([name, declaration.spelled, *default])
        return "" if declaration.base in PRIMITIVES or declaration.base in _OLD_TIMES else declaration.base


class _Declaration(NamedTuple):
    """Type of a field or constant, as the tables spell it and in its parts."""

    spelled: str
    base: str
    max_length: int | None
    brackets: str


def _read_type(declared: str, package: str, generation: Generation) -> _Declaration:
    match = _TYPE.fullmatch(declared)
    if match is None:
        raise ValueError(f"wanted {_TYPE_WORDS}, got {declared}")
    base = match["base"]
    if match["length"] and base not in TEXTS:
        raise ValueError(f"only string and wstring have a greatest length, {base} has none")
    if any(match[bound] and int(match[bound]) == 0 for bound in ("length", "size")):
        raise ValueError(f"a bound is at least 1, got {declared}")
    if generation == "ros1" and base in _HEADERS_OF_ROS1:
        base = "std_msgs/Header"
    elif base not in PRIMITIVES and base not in _OLD_TIMES and "/" not in base:
        meant = get_close_matches(base, PRIMITIVES, n=1) if base.islower() else []
        if meant:
            raise ValueError(f"type {base} is unknown; did you mean {meant[0]}?")
        base = f"{package}/{base}"
    spelled = base + declared[len(match["base"]) :]
    return _Declaration(spelled, base, int(match["length"]) if match["length"] else None, match["brackets"] or "")


def _without_comment(text: str) -> str:
    """Cut a comment off a value; within quotes there is none."""
    place = 0
    if text.startswith(("'", '"', "[")):
        while place < len(text) and text[place] != "#":
            quoted = _QUOTED.match(text, place)
            place = quoted.end() if quoted else place + 1
        return text[:place].rstrip()
    return text.partition("#")[0].rstrip()


def _constant(declaration: _Declaration, text: str, generation: Generation) -> str:
    if declaration.base not in PRIMITIVES or declaration.spelled != declaration.base:
        raise ValueError(f"a constant is of a primitive type without bounds, not of {declaration.spelled}")
    return json.dumps(_value(declaration, text, generation), ensure_ascii=False)


def _default(declaration: _Declaration, text: str, generation: Generation) -> str:
    if declaration.base not in PRIMITIVES:
        raise ValueError(f"only fields of primitive types have defaults, and {declaration.base} is none")
    if not declaration.brackets:
        return json.dumps(_value(declaration, text, generation), ensure_ascii=False)
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError(f"the default of an array is a list such as [1, 2], not {text}")
    elements = [_value(declaration, each, generation) for each in _elements(text[1:-1])]
    size = declaration.brackets[1:-1]
    if size.startswith("<=") and len(elements) > int(size.removeprefix("<=")):
        raise ValueError(f"wanted at most {size.removeprefix('<=')} elements, got {len(elements)}")
    if size.isdigit() and len(elements) != int(size):
        raise ValueError(f"wanted exactly {size} elements, got {len(elements)}")
    return json.dumps(elements, ensure_ascii=False)


def _elements(text: str) -> Iterator[str]:
    if not text.strip():
        return
    start = place = 0
    while place < len(text):
        quoted = _QUOTED.match(text, place) if not text[start:place].strip() else None
        if quoted:
            place = quoted.end()
        elif text[place] == ",":
            yield text[start:place].strip()
            start = place = place + 1
        else:
            place += 1
    yield text[start:].strip()


def _value(declaration: _Declaration, text: str, generation: Generation) -> Scalar:
    base = declaration.base
    try:
        return values.converter(base, declaration.max_length)(_parsed(base, text, generation))
    except MessageError as error:
        raise ValueError(f"wanted {error.wanted}, got {text or 'nothing'}") from None


def _parsed(base: str, text: str, generation: Generation) -> object:
    if base in TEXTS:
        if generation == "ros1" or not text.startswith(("'", '"')):
            return text
        if not _QUOTED.fullmatch(text):
            raise ValueError(f"wanted text in quotes, those in it with a backslash before them, got {text}")
        return re.sub(rf"\\([{text[0]}\\])", r"\1", text[1:-1])
    if base == "bool":
        return {"true": True, "1": True, "false": False, "0": False}.get(text.lower(), text)
    try:
        return float(text) if base.startswith("float") else _integer(text)
    except ValueError:
        return text


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        # 0x1F, 0o17 and 0b101.
        return int(text, 0)


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
