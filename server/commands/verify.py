"""``armbridge verify``: the verification of a running server, at a terminal; a rosbridge client like any other."""

import argparse

from server.commands.options import DEFAULT_URL, Subparsers, add_command, add_token_file, read_token
from server.commands.terminal import ExitCode, Terminal


def add_verify_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "verify",
        _verify,
        "have a running server compare the arm with its model, pose by pose, with you",
        "Ask the server to move the arm slowly to three poses, compare each with the model (on the "
        "server's page), and measure how far each joint stands from its goal. Nothing moves before you say so.",
    )
    parser.add_argument("--url", default=DEFAULT_URL, help=f"of the server ({DEFAULT_URL})")
    parser.add_argument("--arm", default="", metavar="NAME", help="one of several arms of the server, as in left")
    add_token_file(parser, "access.admin_tokens")


def _verify(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.commands.verification_client import verify

    return verify(options.url, read_token(options), terminal, options.arm)
