"""Commands about the installation: ``armbridge config`` shows the settings, ``systemd-unit`` a unit of the server."""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from server.commands.options import Subparsers, add_command, add_setting_options, read_settings
from server.commands.terminal import ExitCode, Terminal, table
from server.config import Settings
from server.config_keys import every_setting, template, toml_value


def add_config_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "config",
        _config,
        "print every setting with its value and its source, or a configuration file to begin with",
        "Print the settings that armbridge serve would have with the same options and environment, and "
        "who has set each: default, file, environment or command line.",
    )
    parser.add_argument(
        "--template", action="store_true", help="print a TOML file with every setting explained, at its default"
    )
    add_setting_options(parser)


def _config(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    if options.template:
        terminal.out(template(Settings).rstrip("\n"))
        return ExitCode.DONE
    terminal.out(table(("setting", "value", "unit", "source"), list(_rows(*read_settings(options)))))
    return ExitCode.DONE


def _rows(settings: Settings, sources: dict[str, str]) -> Iterator[tuple[str, str, str, str]]:
    dumped = settings.model_dump(mode="json")
    for setting in every_setting(Settings):
        value: Any = dumped
        for part in setting.key.split("."):
            value = value[part]
        shown = "-" if value is None else toml_value(value)
        yield setting.key, shown, setting.unit, sources.get(setting.key, "default")


# The arm process brakes, relaxes if it is to, and ends within 5.5 s of the server's death; to park the arm takes up to
# 15 s more, and is waited for. Then it may be killed.
_AFTER_DEATH_S = 6
_PARKING_S = 15

# Words that need no quotes.
_PLAIN = re.compile(r"[A-Za-z0-9_@/.+=:,-]+")

# Template of the unit: braces that stay are doubled.
_UNIT = Path(__file__).with_name("armbridge.service")


def add_systemd_unit_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "systemd-unit",
        _systemd_unit,
        "print a systemd unit that runs the server as a service",
        "Print a systemd unit for this installation: armbridge systemd-unit > armbridge.service.",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in TOML, for the service to read")
    parser.add_argument("--user", metavar="NAME", help="run as this user (made up by systemd)")
    parser.add_argument("--group", metavar="NAME", default="dialout", help="that serial ports belong to (dialout)")


def _systemd_unit(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    command = server_command(Path(sys.executable))
    terminal.out(unit(command, options.config, options.user, options.group).rstrip())
    return ExitCode.DONE


def server_command(python: Path) -> list[str]:
    script = python.parent / "armbridge"
    return [str(script)] if script.is_file() else [str(python), "-P", "-m", "server.cli"]


def unit(command: list[str], config: Path | None, user: str | None, group: str) -> str:
    words = [*command, "serve", *([] if config is None else ["--config", str(config.absolute())])]
    return _UNIT.read_text().format(
        command=" ".join(_quoted(word) for word in words),
        after_death_s=_AFTER_DEATH_S,
        parking_s=_PARKING_S,
        usage=int(ExitCode.USAGE),
        user="DynamicUser=yes" if user is None else f"User={user}",
        group=group,
    )


def _quoted(word: str) -> str:
    """A word of a command line as systemd reads it (systemd.service, systemd.syntax)."""
    escaped = word.replace("%", "%%").replace("$", "$$").replace("\\", "\\\\").replace('"', '\\"')
    return escaped if _PLAIN.fullmatch(escaped) else f'"{escaped}"'
