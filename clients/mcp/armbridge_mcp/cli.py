"""Command ``armbridge-mcp``."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence

from armbridge_mcp.limits import Region
from armbridge_mcp.session import Options
from armbridge_mcp.tools import make_server

# Everyone who reaches the port of streamable HTTP has the token's role.
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def parser() -> argparse.ArgumentParser:
    """Return the command's options."""
    made = argparse.ArgumentParser(
        "armbridge-mcp",
        description="Let a language model look, check and move a robot arm on an armbridge server, with your approval. "
        "A token of the server is read from the environment variable ARMBRIDGE_TOKEN.",
    )
    made.add_argument("--url", default="ws://127.0.0.1:9090", help="address of the armbridge server (%(default)s)")
    made.add_argument("--arm", default="", help="name of one of several arms")
    made.add_argument(
        "--approval",
        choices=("ask", "none"),
        default="ask",
        help="ask: a person approves each motion, on the server's page if the token's role is propose, else in the"
        " program that runs the model; none: motions need no approval (%(default)s)",
    )
    made.add_argument(
        "--max-speed", type=_share, default=0.2, help="most of the joints' velocity limits, 0 to 1 (%(default)s)"
    )
    made.add_argument(
        "--region", type=Region.parse, help="x,y,z,x,y,z [m]: box in which the tip must stay; none by default"
    )
    made.add_argument("--http", metavar="HOST:PORT", help="serve streamable HTTP there, in place of stdio")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve until the client leaves."""
    options = parser().parse_args(arguments)
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    server = make_server(
        Options(options.url, options.arm, options.approval == "ask", options.max_speed, options.region)
    )
    if options.http is None:
        server.run("stdio")
        return
    host, _, port = options.http.rpartition(":")
    if host not in LOOPBACK or not port.isdigit():
        hosts = ", ".join(LOOPBACK)
        sys.exit(
            f"--http must be HOST:PORT with a host of this machine ({hosts}), as it asks for no token: {options.http!r}"
        )
    server.run("streamable-http", host=host.strip("[]"), port=int(port))


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"must be a number above 0 and at most 1, not {text!r}")
    return value
