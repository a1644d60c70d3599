"""``armbridge plan``: the problems of files, planned without a server."""

import argparse
import sys
from pathlib import Path

from robot.description import robot_folder
from server.commands.options import Subparsers, add_command, add_robot
from server.commands.terminal import ExitCode, Terminal

# Options that override a field of every problem.
_PROBLEM_SETTINGS = ("allowed_time_s", "optimization_time_s", "seed")


def add_plan_parser(subparsers: Subparsers) -> None:
    plan = add_command(
        subparsers,
        "plan",
        _plan,
        "plan the problems of files, without a server",
        "Plan the problems of files (docs/planning.md) and print a table. Without --all or --id all"
        " problems but those that a file calls infeasible. A problem whose answer is not as its file expects counts"
        " as a problem found.",
    )
    plan.add_argument("problems", type=Path, nargs="+", metavar="PROBLEM.json", help="the files")
    plan.add_argument("--all", action="store_true", help="plan the infeasible problems as well")
    plan.add_argument("--id", action="append", default=[], metavar="ID", help="plan this problem only; may be repeated")
    plan.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="plan in the workers of the Dask scheduler at tcp://HOST:PORT or tls://HOST:PORT (needs armbridge[dask])",
    )
    plan.add_argument("--json", type=Path, metavar="OUT", help="write trajectories and error codes as JSON")
    plan.add_argument("--plot", type=Path, metavar="OUT.png", help="draw positions and velocities (needs matplotlib)")
    add_robot(plan)
    plan.add_argument(
        "--time", type=float, dest="allowed_time_s", metavar="S", help="seconds after which a problem is given up"
    )
    plan.add_argument(
        "--optimize", type=float, dest="optimization_time_s", metavar="S", help="seconds to spend on a shorter motion"
    )
    plan.add_argument("--seed", type=int, help="of the searches; same seed, same plan")


def _plan(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: it loads the planning libraries.
    from planners.files import plan_command

    settings = {key: getattr(options, key) for key in _PROBLEM_SETTINGS if getattr(options, key) is not None}
    chosen = plan_command.Options(
        options.problems, options.all, tuple(options.id), options.json, options.plot, settings, options.scheduler
    )
    robot = robot_folder.resolve(options.robot).model
    try:
        return ExitCode(plan_command.run(chosen, robot, sys.stdout, sys.stderr))
    except KeyboardInterrupt:
        terminal.err("armbridge: stopped before every problem was planned")
        return ExitCode.FAILED
