"""The command ``armbridge``."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from robot import model
from robot.errors import DescriptionError
from robot.model import RobotModel
from robot.processes import LOG_FORMAT
from server.config import Settings, load
from server.errors import ConfigurationError, StartError

# Exit codes: 0 done, 1 could not run, 2 called wrongly (argparse's own).
EXIT_FAILED = 1
EXIT_USAGE = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _parser().parse_args(arguments)
    code: int = options.run(options)
    return code


def _run_serve(options: argparse.Namespace) -> int:
    try:
        settings = load(options.config, _overrides(options))
    except ConfigurationError as error:
        print(f"armbridge: {error}", file=sys.stderr)  # noqa: T201 - the command's own output
        return EXIT_USAGE
    return _serve(settings)


def _run_plan(options: argparse.Namespace) -> int:
    # Imported when it is needed: it loads the planning libraries.
    from planners.files import plan_command

    settings = {key: getattr(options, key) for key in _PROBLEM_SETTINGS if getattr(options, key) is not None}
    chosen = plan_command.Options(
        options.problems, options.all, tuple(options.id), options.json, options.plot, settings
    )
    try:
        robot = _robot(options.urdf, options.srdf)
    except (ConfigurationError, DescriptionError) as error:
        print(f"armbridge: {error}", file=sys.stderr)  # noqa: T201 - the command's own output
        return EXIT_USAGE
    return plan_command.run(chosen, robot, sys.stdout, sys.stderr)


def _robot(urdf: Path | None, srdf: Path | None) -> RobotModel:
    if urdf is None and srdf is None:
        return model.builtin()
    if urdf is None or srdf is None:
        raise ConfigurationError("--urdf and --srdf must be given together")
    return model.load(urdf, srdf)


def _serve(settings: Settings) -> int:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.app import serve

    logging.basicConfig(level=settings.server.log_level.upper(), format=LOG_FORMAT, stream=sys.stderr)
    # A line for every handshake and request that is no WebSocket; the gateway tells what matters of a client.
    logging.getLogger("websockets").setLevel(logging.WARNING)
    try:
        serve(settings)
    except (StartError, ConfigurationError) as error:
        print(f"armbridge: {error}", file=sys.stderr)  # noqa: T201 - the command's own output
        return EXIT_FAILED
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="armbridge", description="Drive an SO-101 robot arm from any rosbridge client, without ROS."
    )
    parser.add_argument("--version", action="version", version=f"armbridge {metadata.version('armbridge')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_serve(commands)
    _add_plan(commands)
    return parser


def _add_serve(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    serve = commands.add_parser(
        "serve",
        help="start the server, with the simulated arm unless --serial names a real one",
        description="Start the server. Without --serial it drives a simulated arm: the same driver, an emulated bus.",
    )
    serve.add_argument("--host", help="address to listen on (127.0.0.1)")
    serve.add_argument("--port", type=int, help="TCP port (9090); 0 takes a free one")
    serve.add_argument(
        "--serial", metavar="PATH|URL|auto", help="servo bus of a real arm, such as /dev/serial/by-id/..."
    )
    serve.add_argument("--calibration", type=Path, metavar="FILE", help="calibration of the arm, in lerobot's format")
    serve.add_argument("--urdf", type=Path, metavar="FILE", help="the robot's URDF, instead of the built-in SO-101's")
    serve.add_argument("--srdf", type=Path, metavar="FILE", help="the SRDF that goes with --urdf")
    serve.add_argument("--config", type=Path, metavar="FILE", help="settings in TOML; options given here override them")
    serve.add_argument(
        "--log-level", choices=("debug", "info", "warning", "error"), help="least level of the log (info)"
    )
    serve.set_defaults(run=_run_serve)


def _add_plan(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    plan = commands.add_parser(
        "plan",
        help="plan the problems of a file, without a server",
        description="Plan the problems of a file (docs/planning.md) and print a table. Without --all or --id all"
        " problems but those that the file calls infeasible. Exit code 0: every answer is as the file expects; 1: some"
        " are not; 2: nothing was planned.",
    )
    plan.add_argument("problems", type=Path, metavar="PROBLEM.json", help="the file")
    plan.add_argument("--all", action="store_true", help="plan the infeasible problems as well")
    plan.add_argument("--id", action="append", default=[], metavar="ID", help="plan this problem only; may be repeated")
    plan.add_argument("--json", type=Path, metavar="OUT", help="write trajectories and error codes as JSON")
    plan.add_argument("--plot", type=Path, metavar="OUT.png", help="draw positions and velocities (needs matplotlib)")
    plan.add_argument("--urdf", type=Path, metavar="FILE", help="the robot's URDF, instead of the built-in SO-101's")
    plan.add_argument("--srdf", type=Path, metavar="FILE", help="the SRDF that goes with --urdf")
    plan.add_argument(
        "--time", type=float, dest="allowed_time_s", metavar="S", help="give up after so many seconds a problem"
    )
    plan.add_argument(
        "--optimize", type=float, dest="optimization_time_s", metavar="S", help="seconds to spend on a shorter motion"
    )
    plan.add_argument("--seed", type=int, help="of the searches; same seed, same plan")
    plan.set_defaults(run=_run_plan)


# Options of ``plan`` that override a field of every problem.
_PROBLEM_SETTINGS = ("allowed_time_s", "optimization_time_s", "seed")

# Option of ``serve`` -> its section and key in the settings.
_KEYS = {
    "host": ("server", "host"),
    "port": ("server", "port"),
    "log_level": ("server", "log_level"),
    "serial": ("arm", "serial"),
    "calibration": ("arm", "calibration"),
    "urdf": ("arm", "urdf"),
    "srdf": ("arm", "srdf"),
}


def _overrides(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    overrides: dict[str, dict[str, Any]] = {}
    for option, (section, key) in _KEYS.items():
        value = getattr(options, option)
        if value is not None:
            overrides.setdefault(section, {})[key] = value
    return overrides


if __name__ == "__main__":
    sys.exit(main())
