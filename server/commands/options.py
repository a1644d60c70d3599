"""Options that commands share: for the arm's bus, and for settings."""

import argparse
import contextlib
import logging
import math
import os
import re
import signal
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

from planners.errors import PlannerError
from robot import logs
from robot.calibration import Calibration, find_calibration
from robot.description import robot_folder
from robot.description.servo_table import HardwareTable
from robot.errors import CalibrationError, DescriptionError, PortBusy, RobotError
from robot.hardware.boards import AUTO, resolve_port
from robot.hardware.feetech.bus import Bus
from server.arm.setup import DEFAULT_ROBOT
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.config import Settings
from server.config_keys import every_setting
from server.config_loader import load_with_sources
from server.errors import ConfigurationError, ServerError

Subparsers: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001 - argparse has no public name for it

SERIAL_HELP = (
    "the servos' port: a path such as /dev/serial/by-id/..., a USB id such as 1a86:55d3, a URL such as "
    "socket://host:port, or auto for the one adapter plugged in"
)

DEFAULT_URL = "ws://127.0.0.1:9090"

# Where a token does not show in the list of processes.
TOKEN_VARIABLE = "ARMBRIDGE_TOKEN"  # noqa: S105 - the name of a variable

# End of the description of a command that connects to a server.
WITH_TOKEN = f" A token of the server is read from the environment variable {TOKEN_VARIABLE}."

# End of the description of a command that other servos do not know.
FEETECH_ONLY = " For Feetech servos only."

# Carries a command out; its errors become exit codes in `guarded`.
Run: TypeAlias = Callable[[argparse.Namespace, Terminal], ExitCode]


def add_command(
    subparsers: Subparsers, name: str, run: Run, summary: str, description: str, **more: Any
) -> argparse.ArgumentParser:
    """Add a command to a parser; its help ends with the meaning of exit codes."""
    parser = subparsers.add_parser(name, help=summary, description=description, **{"epilog": EXIT_CODES, **more})
    parser.set_defaults(run=run)
    return parser


def add_number(
    parser: argparse.ArgumentParser,
    option: str,
    metavar: str,
    bounds: tuple[float, float],
    default: float | None,
    text: str,
) -> None:
    """Describe an option with a number within bounds: a whole number where they are whole."""
    least, greatest = bounds
    kind = int if isinstance(greatest, int) else float
    wanted = f"a whole number from {least:g} to {greatest:g}" if kind is int else f"{least:g} to {greatest:g}"

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= greatest:
            raise argparse.ArgumentTypeError(f"must be {wanted}, not {text!r}")
        return value

    parser.add_argument(option, type=read, default=default, metavar=metavar, help=text)


def add_connect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--connect", type=websocket_url, default=DEFAULT_URL, metavar="URL", help=f"of the server ({DEFAULT_URL})"
    )


def token_from_environment() -> str | None:
    return os.environ.get(TOKEN_VARIABLE) or None


def add_calibration(parser: argparse.ArgumentParser) -> None:
    text = "the arm's calibration: a file, or the arm's id in lerobot's calibration directory"
    parser.add_argument("--calibration", metavar="NAME_OR_PATH", help=text)


def add_interfaces(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--interfaces",
        type=Path,
        action="append",
        metavar="FOLDER",
        help="a ROS package, or a folder of packages, with msg, srv and action files of your own; may be repeated",
    )


def add_robot(parser: argparse.ArgumentParser, default: str | None = DEFAULT_ROBOT) -> None:
    names = ", ".join(robot_folder.built_in_names())
    parser.add_argument(
        "--robot",
        metavar="NAME_OR_FOLDER",
        default=default,
        help=f"the arm: a built-in one ({names}), or the folder of its robot.toml ({DEFAULT_ROBOT})",
    )


def add_arm(parser: argparse.ArgumentParser) -> None:
    """Describe ``--robot`` and ``--serial``: an arm, and the port of its servos."""
    add_robot(parser)
    parser.add_argument("--serial", metavar="PORT", default=AUTO, help=f"{SERIAL_HELP} ({AUTO})")


def websocket_url(text: str) -> str:
    if not text.startswith(("ws://", "wss://")):
        raise argparse.ArgumentTypeError(f"must begin with ws:// or wss://, not {text!r}")
    return text


def read_hardware(options: argparse.Namespace, kinds: Collection[str] = ("feetech",)) -> HardwareTable:
    """Read the hardware of the robot that the options name, which has servos of one of these kinds."""
    hardware = robot_folder.resolve(options.robot).hardware
    if hardware.kind not in kinds:
        wanted = " or ".join(each.capitalize() for each in kinds)
        raise DescriptionError(
            f"robot {options.robot!r}", f"has hardware of the kind {hardware.kind}: this command needs {wanted} servos"
        )
    return hardware


def open_bus(options: argparse.Namespace) -> Bus:
    return Bus.open(resolve_port(options.serial))


def load_calibration(name: str, hardware: HardwareTable) -> Calibration:
    try:
        return Calibration.load(find_calibration(name, hardware.calibrations, os.environ), hardware.servos)
    except CalibrationError as error:
        raise ConfigurationError(str(error)) from error


@contextlib.contextmanager
def signals_as_ctrl_c() -> Iterator[None]:
    """Take SIGTERM, and SIGHUP of a closed terminal, as Ctrl-C, which undoes the half of a write to a servo."""
    # What nohup ignores stays ignored.
    taken = [each for each in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(each) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """Have Ctrl-C, SIGTERM and SIGHUP wait for what must not be broken off halfway; it ends by itself soon."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def guarded(command: Callable[[Terminal], ExitCode]) -> ExitCode:
    """Run a command; its refusal or failure becomes one line and an exit code."""
    terminal = Terminal()
    try:
        return command(terminal)
    except PortBusy as error:
        terminal.err(f"armbridge: {error}. If that is armbridge serve, stop it first or use its services.")
    except (ConfigurationError, DescriptionError) as error:
        terminal.err(f"armbridge: {error}")
        return ExitCode.USAGE
    except (RobotError, ServerError, PlannerError) as error:
        terminal.err(f"armbridge: {error}")
    except BrokenPipeError:
        raise
    except OSError as error:
        # A path that is too long, or one through a folder of somebody else; a full disk names no file.
        place = "" if error.filename is None else f"{str(error.filename)[:200]}: "
        terminal.err(f"armbridge: {place}{error.strerror or error}")
    except KeyboardInterrupt:
        terminal.err("armbridge: stopped")
    return ExitCode.FAILED


# Options that override one setting: the option, the setting's key, and the placeholder of its value. Everything else
# about them comes from the setting. argparse keeps the value under the key.
_SERVER_OPTIONS = (
    ("--host", "server.host", "HOST"),
    ("--port", "server.port", "PORT"),
    ("--insecure", "access.insecure", ""),
    ("--interfaces", "server.interfaces", "FOLDER"),
)
_FURTHER_OPTIONS = (
    ("--tcp-port", "server.tcp_port", "PORT"),
    ("--log-level", "server.log_level", "LEVEL"),
    ("--serial", "arm.serial", "PORT"),
    ("--simulation", "simulation.kind", "KIND"),
    ("--rate", "simulation.rate", "FACTOR"),
    ("--world", "simulation.world", "NAME_OR_FILE"),
    ("--robot", "arm.robot", "NAME_OR_FOLDER"),
    ("--calibration", "arm.calibration", "NAME_OR_PATH"),
    ("--urdf", "arm.urdf", "FILE"),
    ("--srdf", "arm.srdf", "FILE"),
    ("--package-path", "arm.package_path", "FOLDER"),
    ("--record", "recording.file", "FILE.mcap"),
    ("--record-limit-mb", "recording.limit_mb", "MB"),
)


def add_server_options(parser: argparse.ArgumentParser) -> None:
    _add_options_of_settings(parser, _SERVER_OPTIONS)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="settings in TOML; options given here override them"
    )


def add_setting_options(parser: argparse.ArgumentParser) -> None:
    add_server_options(parser)
    _add_options_of_settings(parser, _FURTHER_OPTIONS)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="assignments",
        help="any setting, as in --set goals.capacity=4; may be repeated (armbridge config lists them)",
    )


def _add_options_of_settings(parser: argparse.ArgumentParser, options: Iterable[tuple[str, str, str]]) -> None:
    settings = {setting.key: setting for setting in every_setting(Settings)}
    for option, key, metavar in options:
        setting = settings[key]
        text = setting.explanation.replace("%", "%%")
        if setting.kinds == {bool}:
            parser.add_argument(option, dest=key, action="store_true", default=None, help=text)
        elif list in setting.kinds:
            parser.add_argument(option, dest=key, action="append", metavar=metavar, help=f"{text} May be repeated.")
        else:
            default = "" if setting.default is None else f" Default: {setting.default}."
            parser.add_argument(option, dest=key, metavar=metavar, help=f"{text}{default}")


def read_settings(options: argparse.Namespace) -> tuple[Settings, dict[str, str]]:
    """Return the settings of file, environment and options, and who has set which, or raise ConfigurationError."""
    return load_with_sources(options.config, overrides(options))


def configure_logs(settings: Settings) -> None:
    logs.configure(settings.server.log_level.upper(), settings.server.log_format)
    # A line for every handshake and request that is no WebSocket; the gateway logs what matters of a client.
    logging.getLogger("websockets").setLevel(logging.WARNING)


def overrides(options: argparse.Namespace) -> dict[str, Any]:
    """The settings that options override, by section and key."""
    values: dict[str, Any] = {}
    given = vars(options)
    for text in given.get("assignments", ()):
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise ConfigurationError(f"--set {_key(text)}: must be KEY=VALUE, as in --set server.port=9191")
        _put(values, key.strip().split("."), _value(key, value.strip()))
    for key, chosen in given.items():
        if "." in key and chosen is not None:
            _put(values, key.split("."), chosen)
    return values


def _put(values: dict[str, Any], path: list[str], value: Any) -> None:
    *sections, name = path
    for section in sections:
        inner = values.setdefault(section, {})
        if not isinstance(inner, dict):
            raise ConfigurationError(f"--set {'.'.join(path)}: {section} has a value already")
        values = inner
    values[name] = value


def _key(text: str) -> str:
    return re.split(r"[^\w.]", text, maxsplit=1)[0]


def _value(key: str, value: str) -> Any:
    """Tables, lists and texts in quotes as TOML has them; the type of everything else is the setting's."""
    if not value.startswith(("{", "[", '"', "'")):
        return value
    try:
        return tomllib.loads(f"value = {value}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"--set {key}: the value is not TOML: {error}") from error
