"""Let an arm follow its leader until Ctrl+C, and print what it does.

The leader is an arm of the server with the role "leader", or a topic of joint states, as of ``armbridge leader``.
The server: ``armbridge serve --config examples/leader_follower.toml``.
"""

import argparse
import signal
import sys

from armbridge_client import ArmError, connect  # pip install ./clients/python


def main() -> None:
    """Start the following, and print its phases until Ctrl+C or a stop ends it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    parser.add_argument("--leader", default="leader", help="an arm, or a topic (default: %(default)s)")
    parser.add_argument("--follower", default="", help="the arm that follows, where there are several")
    parser.add_argument("--mirror", action="store_true", help="move as a mirror would show the leader")
    arguments = parser.parse_args()
    with connect(arguments.url) as arm:
        # Also where Ctrl+C is ignored at first, as in a script's background. Registered before anything moves.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: arm.teleop.stop())
        print(arm.teleop.start(arguments.leader, follower=arguments.follower, mirror=arguments.mirror), flush=True)
        phase = ""
        for state in arm.teleop.states():
            if state.phase != phase:
                phase = state.phase
                print(f"{phase}: {state.message}", flush=True)
            if phase == "idle":
                break


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
