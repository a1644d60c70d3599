"""Commands on descriptions of arms: ``armbridge robot check``, ``robot list`` and ``robot import``."""

import argparse
import os
from pathlib import Path

from planners.errors import PlannerError
from robot.description import robot_folder
from robot.description.meshes import package_path
from robot.description.robot_folder import RobotFolder
from robot.errors import DescriptionError
from robot.hardware.feetech.profiles import profile_of
from server.commands.options import Subparsers, add_command
from server.commands.terminal import ExitCode, Terminal, table


def add_robot_parser(subparsers: Subparsers) -> None:
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
    _add_import(actions)
    for described in actions.choices.values():
        described.set_defaults(usage=described.format_usage())


def _check(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    found = robot_folder.problems(options.folder)
    for problem in found:
        terminal.out(problem)
    if found:
        return ExitCode.PROBLEMS
    resolved = robot_folder.resolve(options.folder)
    # Imported when it is needed: the planning libraries take half a second.
    from planners.assistant.link_shapes import link_shapes

    try:
        profile_of(resolved.hardware.profile)
        if not resolved.model.hulls:
            link_shapes(resolved.model)
    except (DescriptionError, PlannerError) as error:
        terminal.out(str(error))
        return ExitCode.PROBLEMS
    terminal.out(_summary(resolved))
    return ExitCode.DONE


def _list(_options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    arms = [robot_folder.built_in(name) for name in robot_folder.built_in_names()]
    rows = [(arm.name, arm.title, len(arm.model.movable_joints), arm.hardware.kind) for arm in arms]
    terminal.out(table(("name", "arm", "joints", "hardware"), rows))
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


# States that are drawn, and seed: as planners.assistant.importing has them, which loads the planning libraries.
SAMPLES = 20_000


def _add_import(subparsers: Subparsers) -> None:
    command = add_command(
        subparsers,
        "import",
        _import,
        "make a robot folder of a URDF",
        "Make a robot folder of a URDF (docs/robots.md): convex parts of its meshes, a draft"
        " SRDF with groups, named states and the pairs of links that never touch, and a draft robot.toml. The folder is"
        " checked and a motion is planned in it.",
    )
    command.add_argument("urdf", type=Path, metavar="URDF", help="the URDF; expand xacro first")
    command.add_argument("--out", type=Path, metavar="DIR", help="folder to make (the robot's name, here)")
    command.add_argument(
        "--package-path",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="folder that contains the package of package:// names; may be repeated",
    )
    command.add_argument("--base", metavar="LINK", help="first link of the arm (the root)")
    command.add_argument("--tip", metavar="LINK", help="last link of the arm, which pose goals move (found)")
    command.add_argument(
        "--samples", type=int, default=SAMPLES, metavar="N", help=f"states drawn for the pairs of links ({SAMPLES})"
    )
    command.add_argument("--seed", type=int, default=0, metavar="N", help="same files and seed, same folder (0)")
    command.add_argument(
        "--no-convex", action="store_true", help="make no convex parts: meshes are checked themselves, more slowly"
    )
    command.add_argument("--overwrite", action="store_true", help="replace the robot folder that is there")


def _import(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: it loads the planning libraries.
    from planners.assistant import importing

    try:
        out = options.out or importing.default_folder(options.urdf)
        chosen = importing.ImportOptions(
            urdf=options.urdf,
            out=out,
            packages=(*options.package_path, *package_path(os.environ)),
            base=options.base,
            tip=options.tip,
            samples=options.samples,
            seed=options.seed,
            convex=not options.no_convex,
            overwrite=options.overwrite,
        )
        lines = importing.import_robot(chosen, terminal.err)
    except KeyboardInterrupt:
        terminal.err("armbridge: stopped; nothing was written")
        return ExitCode.FAILED
    terminal.out(f"{out} is made:")
    for line in lines:
        terminal.out(f"  {line}")
    # The bare name of a built-in arm is the built-in arm.
    terminal.out(f"next: armbridge serve --robot {out if out.is_absolute() else f'./{out}'}")
    return ExitCode.DONE
