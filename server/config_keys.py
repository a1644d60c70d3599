"""Settings: the base of their sections, and all of them as a list with meaning, unit, range and default of each.

Also the nearest key to an unknown one, and the template of a file.
"""

import difflib
import json
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import groupby
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

from server.errors import ConfigurationError

# Least likeness of a key that is proposed for a mistyped one, by difflib's measure: a less similar key misleads.
LIKENESS = 0.6
NAME_LIKENESS = 0.75

_LIMITS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}

_UNIT = re.compile(r" \[([^]]+)\](?=\.$)")


class SettingsSection(BaseModel):
    """Section of the settings; the docstring under each field is its meaning, with the unit in brackets at the end.

    Options of the command line, ``armbridge config`` and docs/configuration.md come from a field's type, default,
    limits and docstring.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


@dataclass(frozen=True)
class Setting:
    """One setting; ``range`` is empty where the meaning alone names the values."""

    key: str
    section_meaning: str
    meaning: str
    unit: str
    range: str
    default: Any
    field: FieldInfo

    @property
    def section(self) -> str:
        return self.key.rpartition(".")[0]

    @property
    def name(self) -> str:
        return _name(self.key)

    @property
    def kinds(self) -> set[Any]:
        """Types of its values; the type of a list's values is not among them."""
        return {get_origin(kind) or kind for kind in (self.field.annotation, *_members(self.field.annotation))}

    @property
    def explanation(self) -> str:
        """Sentence with unit and range, for users."""
        text = re.sub(r"\bNone\b", "leave it out", self.meaning)
        bounds = ", ".join(filter(None, (self.unit, self.range)))
        return f"{text[:1].upper()}{text[1:]}" + (f" ({bounds})" if bounds else "")


def every_field(model: type[BaseModel], above: str = "") -> Iterator[tuple[str, type[BaseModel], FieldInfo]]:
    """Yield the key of each setting of a model and of the sections in it, with the section's class and the field."""
    sections = []
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            sections.append((field.annotation, f"{above}{name}."))
        else:
            yield f"{above}{name}", model, field
    for section, names in sections:
        yield from every_field(section, names)


def is_table(field: FieldInfo) -> bool:
    """Return True for a setting whose value has keys of its own."""
    return get_origin(field.annotation) is dict


def every_setting(model: type[BaseModel]) -> Iterator[Setting]:
    """Yield the settings of a model and of the sections in it, in their order."""
    for key, section, field in every_field(model):
        sentence = _plain(field.description)
        unit = _UNIT.search(sentence)
        yield Setting(
            key=key,
            section_meaning=_plain(section.__doc__),
            meaning=_UNIT.sub("", sentence),
            unit=unit[1] if unit else "",
            range=_range(field),
            default=to_jsonable_python(field.get_default(call_default_factory=True)),
            field=field,
        )


def nearest(key: str, known: Sequence[str]) -> str:
    """The known key that was probably meant; empty when none is like it."""
    name = _name(key)
    # The right name in a wrong section, or without one, is a better hint than the section.
    same_name = [each for each in known if _name(each) == name]
    found = difflib.get_close_matches(key, same_name or known, n=1, cutoff=0.0 if same_name else LIKENESS)
    if found:
        return found[0]
    by_name = {_name(each): each for each in reversed(known)}
    found = difflib.get_close_matches(name, list(by_name), n=1, cutoff=NAME_LIKENESS)
    return by_name[found[0]] if found else ""


def unknown(key: str, known: Sequence[str], spelling: Callable[[str], str] = str) -> str:
    """Return the sentence that refuses a key; without a spelling the section that both keys share is not shown."""
    meant = nearest(key, known)
    if not meant:
        return f"{spelling(key)}: unknown"
    shown = spelling(meant) if spelling is not str else meant.removeprefix(key.removesuffix(_name(key)))
    return f"{spelling(key)}: unknown; did you mean {shown}?"


def flattened(values: Mapping[str, Any], tables: frozenset[str], above: str = "") -> Iterator[tuple[str, Any]]:
    """Nested values as keys with dots."""
    for name, value in values.items():
        key = f"{above}{name}"
        if isinstance(value, Mapping) and key not in tables:
            yield from flattened(value, tables, f"{key}.")
        else:
            yield key, value


def read_toml(file: Path, kind: str) -> dict[str, Any]:
    """Return the contents of a file, or raise ConfigurationError that begins with its kind."""
    try:
        # Editors of Windows put a byte order mark before the first line.
        return tomllib.loads(file.read_text("utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{kind} {file} cannot be read: {error}") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{kind} {file} is not TOML: {error}") from error


def _name(key: str) -> str:
    return key.rpartition(".")[2]


def _plain(docstring: str | None) -> str:
    return " ".join((docstring or "").split()).replace("``", "")


def _members(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if isinstance(kind, UnionType) else ()


def _range(field: FieldInfo) -> str:
    kind = field.annotation
    if get_origin(kind) is Literal:
        return ", ".join(str(value) for value in get_args(kind))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return ", ".join(str(member.value) for member in kind)
    found = {name: getattr(limit, name) for name in _LIMITS for limit in field.metadata if hasattr(limit, name)}
    if {"ge", "le"} <= found.keys():
        return f"{_number(found['ge'])} to {_number(found['le'])}"
    return ", ".join(f"{_LIMITS[name]} {_number(value)}" for name, value in found.items())


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.10g}"


LINE_WIDTH = 120

_HEAD = "# Every setting of armbridge at its default. Keep the lines that you change; the others may go."


def template(model: type[BaseModel]) -> str:
    lines = [_HEAD]
    for section, settings in groupby(every_setting(model), key=lambda setting: setting.section):
        inside = list(settings)
        lines += ["", f"# {inside[0].section_meaning}", f"[{section}]"] if section else [""]
        for setting in inside:
            lines += _lines(setting)
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{json.dumps(str(key))} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list):
        return f"[{', '.join(toml_value(each) for each in value)}]"
    # JSON and TOML write texts, numbers and booleans alike.
    return json.dumps(value)


def _lines(setting: Setting) -> Iterator[str]:
    for line in textwrap.wrap(setting.explanation, LINE_WIDTH - 2, break_on_hyphens=False, break_long_words=False):
        yield f"# {line}"
    if setting.default is None:
        yield f"# {setting.name} = " + ("..." if {int, float} & setting.kinds else '"..."')
    else:
        yield f"{setting.name} = {toml_value(setting.default)}"
