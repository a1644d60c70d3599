"""``armbridge export``: a recording written as a dataset for learning."""

import argparse
from pathlib import Path

from server.commands.options import Subparsers, add_command, add_interfaces, add_number
from server.commands.terminal import ExitCode, Terminal
from server.datasets.episodes import MAX_GAP_S
from server.interfaces import load_registry

MAX_FPS = 100
DEFAULT_FPS = 30

GREATEST_GAP_S = 60.0


def add_export_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "export",
        _export,
        "write a recording as a dataset for learning (LeRobotDataset v3.0)",
        "Write a recording of serve --record or ROS 2 as a dataset for learning (docs/policies.md): the states of the"
        " arm, the actions that were asked for, and what cameras saw, at a fixed rate. Episodes are those marked on"
        " /dataset/episode; a recording without marks is one episode. Omissions count as problems. Needs"
        " armbridge[datasets].",
    )
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="an MCAP file, or a bag of ROS 2")
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
        options.recording,
        options.output,
        options.fps,
        options.task,
        options.action_topic,
        options.state_topic,
        options.units,
        video=not options.no_video,
        max_gap_s=options.max_gap,
    )
    done = export(chosen, load_registry(options.interfaces or ()), terminal.err)
    for problem in done.problems:
        terminal.err(f"* {problem}")
    cameras = ", ".join(done.cameras) or "no camera"
    terminal.out(
        f"{options.output}: {done.episodes} episodes, {done.frames} frames at {options.fps} a second, {cameras};"
        f" actions: {done.actions}"
    )
    return ExitCode.PROBLEMS if done.problems else ExitCode.DONE
