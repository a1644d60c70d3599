"""Commands on descriptions of arms: ``armbridge robot check``, ``robot list`` and ``robot import``."""

from __future__ import annotations

import argparse

from robot.description import robot_folder
from robot.description.robot_folder import RobotFolder
from robot.errors import DescriptionError
from robot.hardware.feetech.profiles import profile_of
from server.commands.options import Subparsers, add_command
from server.commands.robot_import import add_parser
from server.commands.terminal import ExitCode, Terminal, table


def add_robot_parser(subparsers: Subparsers) -> None:
    """Describe the commands."""
    parser = subparsers.add_parser(
        "robot",
        help="make or check the folder of an arm, and list the built-in ones",
        description="Arms are folders with a robot.toml, a URDF and an SRDF (docs/robots.md).",
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    check = add_command(
        actions,
        "check",
        _check,
        "say everything that is wrong with an arm's folder",
        "Read an arm's robot.toml and all files that it names; print the arm, or everything that is wrong.",
    )
    check.add_argument("folder", metavar="NAME_OR_FOLDER", help="a folder with a robot.toml, or a built-in arm")
    add_command(actions, "list", _list, "list the built-in arms", "List the built-in arms.")
    add_parser(actions)
    for described in actions.choices.values():
        described.set_defaults(usage=described.format_usage())


def _check(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    found = robot_folder.problems(options.folder)
    for problem in found:
        terminal.tell(problem)
    if found:
        return ExitCode.PROBLEMS
    resolved = robot_folder.resolve(options.folder)
    try:
        profile_of(resolved.hardware.profile)
    except DescriptionError as error:
        terminal.tell(str(error))
        return ExitCode.PROBLEMS
    terminal.tell(_summary(resolved))
    return ExitCode.DONE


def _list(_options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    arms = [robot_folder.built_in(name) for name in robot_folder.built_in_names()]
    rows = [(arm.name, arm.title, len(arm.model.movable_joints), arm.hardware.kind) for arm in arms]
    terminal.tell(table(("name", "arm", "joints", "hardware"), rows))
    return ExitCode.DONE


def _summary(found: RobotFolder) -> str:
    arm, hardware = found.model, found.hardware
    servos = {servo.joint: f"{servo.model}, id {servo.servo_id}" for servo in hardware.servos}
    rows = [
        (
            joint.name,
            joint.type,
            f"{joint.lower:.3f} .. {joint.upper:.3f}",
            f"{joint.max_velocity:g}",
            f"{joint.max_acceleration:g}",
            servos.get(joint.name, "-"),
        )
        for joint in arm.movable_joints
    ]
    gripper = "none" if arm.gripper is None else ", ".join(arm.gripper.joints)
    groups = "; ".join(f"{group.name}: {', '.join(group.joints)}" for group in arm.groups.values())
    return "\n".join(
        [
            f"{found.title} ({found.folder}), hardware: {hardware.kind}",
            table(("joint", "type", "range", "velocity", "acceleration", "servo"), rows),
            f"groups: {groups}",
            f"group of goals that name none: {arm.default_group}, tip {arm.tip_link}, planning frame {arm.root_link}",
            f"gripper: {gripper}",
        ]
    )
