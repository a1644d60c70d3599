"""Reads the settings from a TOML file, the environment and the command line, and notes the source of each."""

import functools
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_settings import EnvSettingsSource, SettingsError

from server.config import PREFIX, NamedArmSettings, Settings
from server.config_keys import every_field, flattened, is_table, read_toml, unknown
from server.errors import ConfigurationError, sentence_of

# Settings whose values may be secret, and must not get into logs by a refusal.
_SECRET = (
    "access.token",
    "access.admin_tokens",
    "access.operate_tokens",
    "access.propose_tokens",
    "access.view_tokens",
)


def load(file: Path | None, overrides: dict[str, Any]) -> Settings:
    return load_with_sources(file, overrides)[0]


def load_with_sources(file: Path | None, overrides: dict[str, Any]) -> tuple[Settings, dict[str, str]]:
    """Read the settings, and by key, for those that are set, ``file``, ``environment`` or ``command line``.

    Raises ConfigurationError that names the key; a value that another one overrides is checked like any other.
    """
    in_file = read_toml(file, "configuration") if file else {}
    if stray := _stray_variables():
        raise ConfigurationError("; ".join(stray))
    try:
        layers = {"file": in_file, "environment": EnvSettingsSource(Settings)(), "command line": overrides}
        tables = frozenset(key for key, _, field in every_field(Settings) if is_table(field))
        keys = {layer: [key for key, _ in flattened(values, tables)] for layer, values in layers.items()}
        sources = {key: layer for layer, own in keys.items() for key in own}
        # Sources of values in refusals.
        places = {"file": f"file {file}"}
        for layer, values in layers.items():
            _check_values(values, layers.values(), dict.fromkeys(keys[layer], places.get(layer, layer)))
        # Settings itself reads the environment, below what it is called with.
        return Settings(**functools.reduce(_merged, layers.values())), sources
    except SettingsError as error:
        raise ConfigurationError(_unreadable(error)) from error
    except ValidationError as error:
        raise ConfigurationError("; ".join(_sentence(each, sources) for each in error.errors())) from error


def _unreadable(error: SettingsError) -> str:
    """Return the sentence about a variable that is not JSON, which the error does not name; its value may be secret."""
    text = getattr(error.__cause__, "doc", None)
    names = [name for name, value in os.environ.items() if name.upper().startswith(PREFIX) and value == text]
    if not names:
        return f"environment: {error}"
    example = """a list as in ["first", "second"], or a table as in {"name": "value"}"""
    return f"environment variable {' or '.join(names)}: must be JSON, {example}"


def _check_values(values: dict[str, Any], layers: Iterable[dict[str, Any]], places: dict[str, str]) -> None:
    """Refuse wrong values of one layer, also overridden ones; contradictions may be mended by a layer above."""
    try:
        Settings(**functools.reduce(_merged, (*layers, values)))
    except ValidationError as error:
        own = [each for each in error.errors() if _place(_key(each), places)]
        if own:
            raise ConfigurationError("; ".join(_sentence(each, places) for each in own)) from error


def known_keys() -> list[str]:
    """Every key that can be set, as in ``server.port``, and the sections."""
    keys = [key for key, _, _ in every_field(Settings)]
    sections = {key.rpartition(".")[0] for key in keys}
    return keys + sorted(sections)


def _stray_variables() -> list[str]:
    known = known_keys()
    tables = tuple(f"{key}." for key, _, field in every_field(Settings) if is_table(field))
    names = sorted(name.lower() for name in os.environ if name.upper().startswith(PREFIX))
    keys = [name.removeprefix(PREFIX.lower()).replace("__", ".") for name in names]
    return [
        f"environment variable {unknown(key, known, _variable)}"
        for key in keys
        if key not in known and not key.startswith(tables)
    ]


def _variable(key: str) -> str:
    return PREFIX + key.upper().replace(".", "__")


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Merge nested values; of a key that both have, the value above counts."""
    merged = {**below, **above}
    for key in below.keys() & above.keys():
        if isinstance(below[key], dict) and isinstance(above[key], dict):
            merged[key] = _merged(below[key], above[key])
    return merged


def _key(problem: Any) -> str:
    return ".".join(str(part) for part in problem["loc"])


def _place(key: str, places: dict[str, str]) -> str:
    """Return the place of a value, or of the table that it stands in; empty for another one."""
    return next((place for each, place in places.items() if f"{key}.".startswith(f"{each}.")), "")


def _sentence(problem: Any, places: dict[str, str]) -> str:
    key = _key(problem)
    if problem["type"] == "extra_forbidden":
        arm = f"arms.{problem['loc'][1]}." if key.startswith("arms.") else ""
        known = [f"{arm}{each}" for each, _, _ in every_field(NamedArmSettings)] if arm else known_keys()
        return unknown(key, known)
    value = problem.get("input")
    place = _place(key, places)
    source = f", from the {place}" if place else ""
    if key == "access" or key.startswith(_SECRET):
        shown = f" (it is not shown{source})"
    else:
        shown = "" if isinstance(value, dict | BaseModel) else f" (it is {value!r}{source})"
    return f"{key or 'settings'}: {sentence_of(problem)}{shown}"
