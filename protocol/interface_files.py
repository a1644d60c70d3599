"""Reader of one interface file of ROS: the text of a ``.msg``, ``.srv`` or ``.action`` becomes a definition.

The grammar has what both generations write: bounds, defaults and wide text (rosidl_adapter), ``time`` and ``duration``
(genmsg). ROS 1 alone knows ``Header`` without a package, and takes a text constant as it stands. Comments are passed
over.

A file is read to its end; each line that cannot be read becomes a `Flaw`. The caller,
which knows all files, resolves the types that the file refers to.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

from protocol import values
from protocol.errors import MessageError, one_line, shorten
from protocol.registry import PRIMITIVES, TEXTS, Definition, Kind, Scalar

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
