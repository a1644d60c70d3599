"""Move the arm to a named target and wait until it is there; the server: ``armbridge serve``."""

import argparse
import sys

from armbridge_client import ArmError, connect  # pip install ./clients/python


def main() -> None:
    """Move, and print the server's sentence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    parser.add_argument("name", nargs="?", default="ready", help="such as home or rest (default: %(default)s)")
    arguments = parser.parse_args()
    with connect(arguments.url) as arm:
        print(arm.move_named(arguments.name).message)


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
