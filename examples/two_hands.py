"""Move two arms at the same time, each by its name, then both together as one group.

The server: ``armbridge serve --config examples/two_arms.toml``.
"""

import argparse
import sys
import threading
from typing import Any

import roslibpy  # pip install roslibpy

CONNECT_TIMEOUT_S = 4
MOTION_TIMEOUT_S = 30

ARMS = ("left", "right")
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
    """Move the arms, print how each motion ended, and return 0 if all have ended well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1", help="name or address of the server (default: %(default)s)")
    parser.add_argument("--port", default=9090, type=int, help="port of the server (default: %(default)s)")
    arguments = parser.parse_args()
    client = connect(arguments.host, arguments.port)
    topics = client.get_topics()
    if not all(f"/{arm}/moveit_goal_result" in topics for arm in ARMS):
        client.terminate()
        print("the server has no arms left and right: start it with --config examples/two_arms.toml")
        return 1

    results: dict[str, dict[str, Any]] = {}
    both_ended = threading.Event()

    def take_result(arm: str, result: dict[str, Any]) -> None:
        results[arm] = result
        print(f"{arm}: {result['val']} {result['message']}")
        if len(results) == len(ARMS):
            both_ended.set()

    # Subscribe first: a result published before the subscription would be missed.
    for arm in ARMS:
        topic = roslibpy.Topic(client, f"/{arm}/moveit_goal_result", "moveit_msgs/MoveItErrorCodes")
        topic.subscribe(lambda result, arm=arm: take_result(arm, result))

    # Joints of an arm are named with its name or without, below its name.
    for arm, turn in (("left", 0.6), ("right", -0.6)):
        goal = roslibpy.Message({"name": ["shoulder_pan", "elbow_flex"], "position": [turn, 0.4]})
        roslibpy.Topic(client, f"/{arm}/moveit_goal_joints", "sensor_msgs/JointState").publish(goal)
    if not both_ended.wait(MOTION_TIMEOUT_S):
        client.terminate()
        print(f"no result within {MOTION_TIMEOUT_S} s")
        return 1

    together = roslibpy.Service(client, "/moveit_goal", "armbridge_msgs/MoveitGoal")
    answer = together.call(roslibpy.ServiceRequest({"group": "both_arms", "named": "home"}), timeout=MOTION_TIMEOUT_S)
    print(f"both: {answer['code']} {answer['message']}")
    client.terminate()
    return 0 if answer["success"] and all(result["val"] == SUCCESS for result in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
