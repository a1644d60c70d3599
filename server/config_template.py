"""A configuration file with every setting at its default, each explained."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any

from server.config_keys import Setting

LINE_WIDTH = 100

_HEAD = "# Every setting of armbridge at its default. Keep the lines that you change; the others may go."


def template(settings: Iterable[Setting]) -> str:
    """The text of the file, in TOML.

    Args:
        settings: those that it shows, each section's in one piece.
    """
    lines = [_HEAD]
    for section, inside in groupby(settings, key=lambda setting: setting.section):
        lines += ["", f"[{section}]"]
        for setting in inside:
            lines += _lines(setting)
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A value as TOML writes it.

    Args:
        value: a text, number or boolean, or a mapping or list of such.
    """
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
