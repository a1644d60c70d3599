"""Settings: the base of their sections, and all of them as a list with meaning, unit, range and default of each.

Also the nearest key to an unknown one, and the template of a file.
"""

from __future__ import annotations

import ast
import difflib
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import groupby, pairwise
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

# Who mistypes a name has most of it right; below this share of equal letters a proposal misleads.
LIKENESS = 0.6
NAME_LIKENESS = 0.75

_LIMITS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}

_UNIT = re.compile(r" \[([^]]+)\](?=\.$)")


class SettingsSection(BaseModel):
    """Section of the settings; the docstring under each field is its meaning, with the unit in brackets at the end."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class Setting:
    """One setting.

    Attributes:
        range: which values it takes; empty where the meaning alone says so.
    """

    key: str
    meaning: str
    unit: str
    range: str
    default: Any
    is_number: bool

    @property
    def section(self) -> str:
        """The key without its last part."""
        return self.key.rpartition(".")[0]

    @property
    def name(self) -> str:
        """The last part of the key."""
        return _name(self.key)


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
    for section, fields in groupby(every_field(model), key=lambda each: each[1]):
        docstrings = _docstrings(section)
        for key, _, field in fields:
            sentence = " ".join(docstrings.get(_name(key), "").split()).replace("``", "")
            unit = _UNIT.search(sentence)
            yield Setting(
                key=key,
                meaning=_UNIT.sub("", sentence),
                unit=unit[1] if unit else "",
                range=_range(field),
                default=to_jsonable_python(field.get_default(call_default_factory=True)),
                is_number=bool({int, float} & {field.annotation, *get_args(field.annotation)}),
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
    """The sentence that refuses a key.

    Args:
        spelling: how both are shown; the default shows them as they are, without the section that they share.
    """
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


def _name(key: str) -> str:
    return key.rpartition(".")[2]


def _docstrings(section: type[BaseModel]) -> dict[str, str]:
    """Return the docstring under each field, from the source.

    pydantic's ``use_attribute_docstrings`` reads it at the import of each section, which takes every start 60 ms more.
    """
    found = {}
    (definition,) = ast.parse(inspect.getsource(section)).body
    for field, below in pairwise(definition.body if isinstance(definition, ast.ClassDef) else []):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = text
    return found


def _range(field: FieldInfo) -> str:
    kind = field.annotation
    if kind is bool:
        return "true, false"
    if get_origin(kind) is Literal:
        return ", ".join(str(value) for value in get_args(kind))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return ", ".join(str(member.value) for member in kind)
    return _limits(field.metadata)


def _limits(metadata: Sequence[Any]) -> str:
    found = []
    for name, words in _LIMITS.items():
        found += [f"{words} {getattr(limit, name):g}" for limit in metadata if hasattr(limit, name)]
    return ", ".join(found)


LINE_WIDTH = 100

_HEAD = "# Every setting of armbridge at its default. Keep the lines that you change; the others may go."


def template(settings: Iterable[Setting]) -> str:
    """The text of the file, in TOML."""
    lines = [_HEAD]
    for section, inside in groupby(settings, key=lambda setting: setting.section):
        lines += ["", f"[{section}]"] if section else [""]
        for setting in inside:
            lines += _lines(setting)
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{json.dumps(str(key))} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list):
        return f"[{', '.join(toml_value(each) for each in value)}]"
    # JSON and TOML write texts, numbers and booleans alike.
    return json.dumps(value)


def _lines(setting: Setting) -> Iterator[str]:
    text = re.sub(r"\bNone\b", "leave it out", setting.meaning)
    bounds = ", ".join(filter(None, (setting.unit, setting.range)))
    explained = f"{text[:1].upper()}{text[1:]}" + (f" ({bounds})" if bounds else "")
    for line in textwrap.wrap(explained, LINE_WIDTH, break_on_hyphens=False, break_long_words=False):
        yield f"# {line}"
    if setting.default is None:
        yield f"# {setting.name} = " + ("..." if setting.is_number else '"..."')
    else:
        yield f"{setting.name} = {toml_value(setting.default)}"
