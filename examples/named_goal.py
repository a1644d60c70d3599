"""Move the arm to a named target and wait until it is there; the server: ``armbridge serve``."""

import argparse
import sys
import threading
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
MOTION_TIMEOUT_S = 30

# Result codes are those of moveit_msgs/MoveItErrorCodes.
SUCCESS = 1


def connect(host: str, port: int) -> roslibpy.Ros:
    """Return a connection to the server, or end the program if no server answers."""
    client = roslibpy.Ros(host=host, port=port)
    try:
        client.run(timeout=CONNECT_TIMEOUT_S)
    except roslibpy.core.RosTimeoutError:
        sys.exit(f'no server answers at ws://{host}:{port}: start one with "make run"')
    return client


def main() -> int:
    """Send the goal, wait for its result, and return 0 if the arm has reached the target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    parser.add_argument(
        "name", nargs="?", default="ready", help="target, such as home, ready or rest (default: %(default)s)"
    )
    arguments = parser.parse_args()
    client = connect(arguments.host, arguments.port)

    results: list[dict[str, Any]] = []
    finished = threading.Event()

    def take_result(result: dict[str, Any]) -> None:
        # Results of all goals arrive on this topic; `source` is the topic of the goal and a number.
        if result["source"].startswith("/moveit_goal_named#"):
            results.append(result)
            finished.set()

    # Subscribe first: a result published before the subscription would be missed.
    roslibpy.Topic(client, "/moveit_goal_result", "moveit_msgs/MoveItErrorCodes").subscribe(take_result)
    goal = roslibpy.Message({"data": arguments.name})
    roslibpy.Topic(client, "/moveit_goal_named", "std_msgs/String").publish(goal)

    in_time = finished.wait(MOTION_TIMEOUT_S)
    client.terminate()
    if not in_time:
        print(f"no result within {MOTION_TIMEOUT_S} s")
        return 1
    print(results[0]["val"], results[0]["message"])
    return 0 if results[0]["val"] == SUCCESS else 1


if __name__ == "__main__":
    sys.exit(main())
