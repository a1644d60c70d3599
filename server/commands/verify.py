"""``armbridge verify``: the verification of a running server, at a terminal; a rosbridge client like any other."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from server.commands.options import Subparsers, guarded
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal

DEFAULT_URL = "ws://127.0.0.1:9090"

# Where a token does not show in the list of processes.
TOKEN_VARIABLE = "ARMBRIDGE_TOKEN"  # noqa: S105 - the name of a variable


def add_verify_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "verify",
        help="have a running server compare the arm with its model, pose by pose, with you",
        description="Ask the server to move the arm slowly to three poses, compare each with the model (on the "
        "server's page), and measure how far each joint stands from its goal. Nothing moves before you say so.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--url", default=DEFAULT_URL, help=f"of the server ({DEFAULT_URL})")
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help=f"file with one of access.admin_tokens and nothing else; else it comes from {TOKEN_VARIABLE}",
    )
    parser.set_defaults(run=run_verify)


def run_verify(options: argparse.Namespace) -> int:
    """Carry out the command."""
    return guarded(lambda terminal: _verify(options, terminal))


def _verify(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.commands.verification_client import verify

    token = os.environ.get(TOKEN_VARIABLE)
    if options.token_file is not None:
        try:
            token = options.token_file.read_text().strip()
        except (OSError, ValueError) as error:
            terminal.say(f"armbridge: --token-file: {options.token_file} cannot be read: {error}")
            return ExitCode.USAGE
    return verify(options.url, token, terminal)
