"""``armbridge config``: the settings as they are, and where each comes from."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from typing import Any

from server.commands.options import Subparsers, add_setting_options, read_settings
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal, table
from server.config import Settings
from server.config_keys import Setting, every_setting, template, toml_value
from server.errors import ConfigurationError


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "config",
        help="print every setting with its value and its source, or a configuration file to begin with",
        description="Print the settings that armbridge serve would have with the same options and environment, and "
        "who has set each: default, file, environment or command line.",
        epilog=EXIT_CODES,
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print them as a JSON object, by key")
    form.add_argument(
        "--template", action="store_true", help="print a TOML file with every setting explained, at its default"
    )
    add_setting_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    terminal = Terminal()
    if options.template:
        terminal.tell(template(every_setting(Settings)).rstrip("\n"))
        return ExitCode.DONE
    try:
        settings, sources = read_settings(options)
    except ConfigurationError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.USAGE
    values = list(_effective(settings, sources))
    terminal.tell(_as_json(values) if options.json else _as_table(values))
    return ExitCode.DONE


def _effective(settings: Settings, sources: dict[str, str]) -> Iterator[tuple[Setting, Any, str]]:
    """Every setting with its value and its source."""
    dumped = settings.model_dump(mode="json")
    for setting in every_setting(Settings):
        value: Any = dumped
        for part in setting.key.split("."):
            value = value[part]
        yield setting, value, sources.get(setting.key, "default")


def _as_json(values: list[tuple[Setting, Any, str]]) -> str:
    return json.dumps({setting.key: {"value": value, "source": source} for setting, value, source in values}, indent=2)


def _as_table(values: list[tuple[Setting, Any, str]]) -> str:
    rows = [
        (setting.key, "-" if value is None else toml_value(value), setting.unit, source)
        for setting, value, source in values
    ]
    return table(("setting", "value", "unit", "source"), rows)
