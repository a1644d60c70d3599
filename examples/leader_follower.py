"""Let an arm follow its leader until Ctrl+C, and print what it does.

The leader is an arm of the server with the role "leader", or a topic of joint states, as of ``armbridge leader``.
The server: ``armbridge serve --config examples/leader_follower.toml``.
"""

import argparse
import signal
import sys
import threading
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
CALL_TIMEOUT_S = 10


def connect(host: str, port: int) -> roslibpy.Ros:
    """Return a connection to the server, or end the program if no server answers."""
    client = roslibpy.Ros(host=host, port=port)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f'no server answers at ws://{host}:{port}: start one with "make run"')
    return client


def main() -> int:
    """Start the following, print its phases, and return 0 if it ended by Ctrl+C or a stop."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    parser.add_argument("--leader", default="leader", help="an arm, or a topic (default: %(default)s)")
    parser.add_argument("--follower", default="", help="the arm that follows, where there are several")
    parser.add_argument("--mirror", action="store_true", help="move as a mirror would show the leader")
    arguments = parser.parse_args()
    client = connect(arguments.host, arguments.port)

    ended, asked_to_end = threading.Event(), threading.Event()
    phases: list[str] = []

    def take_state(state: dict[str, Any]) -> None:
        # What is told first is the end of the following before.
        if state["phase"] == "idle" and not phases:
            return
        if not phases or phases[-1] != state["phase"]:
            phases.append(state["phase"])
            print(f"{state['phase']}: {state['message']}", flush=True)
        if state["phase"] == "idle":
            ended.set()

    # Also where Ctrl+C is ignored at first, as in a script's background. Registered before anything moves.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked_to_end.set())
    roslibpy.Topic(client, "/teleop/state", "armbridge_msgs/TeleopState").subscribe(take_state)
    request = {"follower": arguments.follower, "leader": arguments.leader, "mirror": arguments.mirror}
    start = roslibpy.Service(client, "/teleop/start", "armbridge_msgs/StartTeleop")
    answer = start.call(roslibpy.ServiceRequest(request), timeout=CALL_TIMEOUT_S)
    print(answer["message"], flush=True)
    if not answer["success"]:
        client.terminate()
        return 1
    while not ended.wait(0.2) and not asked_to_end.is_set():
        pass
    if not ended.is_set():
        roslibpy.Service(client, "/teleop/stop", "std_srvs/Trigger").call(
            roslibpy.ServiceRequest(), timeout=CALL_TIMEOUT_S
        )
        ended.wait(CALL_TIMEOUT_S)
    client.terminate()
    return 0


if __name__ == "__main__":
    sys.exit(main())
