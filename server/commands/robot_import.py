"""``armbridge robot import``: a robot folder made of a URDF."""

from __future__ import annotations

import argparse
from pathlib import Path

from server.commands.options import Subparsers, add_command
from server.commands.terminal import ExitCode, Terminal

# States that are drawn, and seed: as planners.assistant.importing has them, which loads the planning libraries.
SAMPLES = 20_000


def add_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    command = add_command(
        subparsers,
        "import",
        _import,
        "make a robot folder of a URDF",
        "Make a robot folder of a URDF (docs/bring_your_own_arm.md): convex parts of its meshes, a draft"
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
    from planners.errors import PlannerError

    try:
        out = options.out or importing.default_folder(options.urdf)
        chosen = importing.ImportOptions(
            urdf=options.urdf,
            out=out,
            packages=tuple(options.package_path),
            base=options.base,
            tip=options.tip,
            samples=options.samples,
            seed=options.seed,
            convex=not options.no_convex,
            overwrite=options.overwrite,
        )
        lines = importing.import_robot(chosen, terminal.say)
    except (PlannerError, OSError) as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.FAILED
    except KeyboardInterrupt:
        terminal.say("armbridge: stopped; nothing was written")
        return ExitCode.FAILED
    terminal.tell(f"{out} is made:")
    for line in lines:
        terminal.tell(f"  {line}")
    terminal.tell(f"next: armbridge serve --robot {out}")
    return ExitCode.DONE
