"""Commands on files: ``armbridge plan`` plans problems, ``armbridge export`` makes a dataset of recordings."""

import argparse
import sys
from pathlib import Path

from robot.description import model, robot_folder
from robot.description.model import RobotModel
from robot.errors import DescriptionError
from server.commands.options import Subparsers, add_command, add_interfaces, add_number, add_robot
from server.commands.terminal import ExitCode, Terminal
from server.datasets.episodes import MAX_GAP_S
from server.errors import ConfigurationError
from server.interfaces import load_registry

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
    plan.add_argument("--urdf", type=Path, metavar="FILE", help="a URDF in place of the robot's")
    plan.add_argument("--srdf", type=Path, metavar="FILE", help="the SRDF that goes with --urdf")
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
    try:
        robot = _robot(options.robot, options.urdf, options.srdf)
    except DescriptionError as error:
        raise ConfigurationError(str(error)) from error
    try:
        return ExitCode(plan_command.run(chosen, robot, sys.stdout, sys.stderr))
    except KeyboardInterrupt:
        terminal.say("armbridge: stopped before every problem was planned")
        return ExitCode.FAILED


def _robot(name: str, urdf: Path | None, srdf: Path | None) -> RobotModel:
    if urdf is None and srdf is None:
        return robot_folder.resolve(name).model
    if urdf is None or srdf is None:
        raise ConfigurationError("--urdf and --srdf must be given together")
    return model.load(urdf, srdf)


MAX_FPS = 100
DEFAULT_FPS = 30

GREATEST_GAP_S = 60.0


def add_export_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "export",
        _export,
        "write recordings as a dataset for learning (LeRobotDataset v3.0)",
        "Write recordings of serve --record or ROS 2 as a dataset for learning (docs/policies.md): the states of the"
        " arm, the actions that were asked for, and what cameras saw, at a fixed rate. Episodes are those marked on"
        " /dataset/episode; a recording without marks is one episode. Omissions count as problems. Needs"
        " armbridge[datasets].",
    )
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING", help="MCAP files, or bags of ROS 2")
    parser.add_argument("--format", choices=("lerobot",), default="lerobot", help="LeRobotDataset v3.0 (lerobot)")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder to make")
    text = f"frames a second, 1 to {MAX_FPS} ({DEFAULT_FPS})"
    add_number(parser, "--fps", "N", (1, MAX_FPS), DEFAULT_FPS, text)
    parser.add_argument("--task", metavar="TEXT", help="what the arm does, for episodes whose marks do not say it")
    parser.add_argument(
        "--action-topic",
        metavar="TOPIC",
        help="topic of the actions (the leader's, else a controller's state, else the next state is the action)",
    )
    parser.add_argument(
        "--state-topic",
        metavar="TOPIC",
        help="topic of the joints' states (/joint_states, or the only one with sensor_msgs/JointState)",
    )
    parser.add_argument(
        "--units",
        choices=("rad", "lerobot"),
        default="rad",
        help="radians, or degrees with the gripper in percent of its range, as lerobot has them (rad)",
    )
    text = f"longest time without a state, action or image in an episode that is exported [s] ({MAX_GAP_S})"
    add_number(parser, "--max-gap", "S", (0.0, GREATEST_GAP_S), MAX_GAP_S, text)
    parser.add_argument("--no-video", action="store_true", help="leave the cameras out")
    add_interfaces(parser)


def _export(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.datasets.export import ExportOptions, export

    chosen = ExportOptions(
        options.recordings,
        options.output,
        options.fps,
        options.task,
        options.action_topic,
        options.state_topic,
        options.units,
        video=not options.no_video,
        max_gap_s=options.max_gap,
    )
    done = export(chosen, load_registry(options.interfaces or ()), terminal.say)
    for problem in done.problems:
        terminal.say(f"* {problem}")
    cameras = ", ".join(done.cameras) or "no camera"
    terminal.tell(
        f"{options.output}: {done.episodes} episodes, {done.frames} frames at {options.fps} a second, {cameras};"
        f" actions: {done.actions}"
    )
    return ExitCode.PROBLEMS if done.problems else ExitCode.DONE
