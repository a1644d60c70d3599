"""Drives a server from outside its container, as any client would: ``python drive.py PORT [TOKEN]``.

Needs ``websockets``. Ends with exit code 1 and a sentence when something does not work.
"""

from __future__ import annotations

import itertools
import json
import sys
import urllib.request
from typing import Any

from websockets.sync.client import ClientConnection, connect

TIMEOUT_S = 20.0
MOVED_RAD = 0.2
SUCCESS = 1

Message = dict[str, Any]


class Client:
    """A rosbridge client that waits for one thing at a time."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._calls = (f"call {number}" for number in itertools.count())

    def subscribe(self, topic: str, type_name: str) -> None:
        """Subscribe to a topic."""
        self._send(op="subscribe", topic=topic, type=type_name)

    def publish(self, topic: str, type_name: str, message: Message) -> None:
        """Publish a message."""
        self._send(op="advertise", topic=topic, type=type_name)
        self._send(op="publish", topic=topic, msg=message)

    def next(self, topic: str) -> Message:
        """The next message on a topic."""
        message: Message = self._until(op="publish", topic=topic)["msg"]
        return message

    def call(self, service: str, arguments: Message) -> Message:
        """Call a service; returns its answer."""
        name = next(self._calls)
        self._send(op="call_service", service=service, id=name, args=arguments)
        values: Message = self._until(op="service_response", id=name)["values"]
        return values

    def _send(self, **frame: Any) -> None:
        self._connection.send(json.dumps(frame))

    def _until(self, **fields: str) -> Message:
        while True:
            frame: Message = json.loads(self._connection.recv(timeout=TIMEOUT_S))
            if fields.items() <= frame.items():
                return frame


def main(arguments: list[str]) -> int:
    """Try the page, a goal, and a straight line."""
    address = f"127.0.0.1:{arguments[0]}"
    headers = {"Authorization": f"Bearer {arguments[1]}"} if len(arguments) > 1 else {}
    check_page(f"http://{address}/", headers)
    with connect(f"ws://{address}", additional_headers=headers, open_timeout=TIMEOUT_S) as connection:
        client = Client(connection)
        check_goal(client)
        check_straight_line(client)
    return 0


def check_page(url: str, headers: dict[str, str]) -> None:
    """The page of a checkout without npm says how to get one, with another status."""
    request = urllib.request.Request(url, headers=headers)  # noqa: S310
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:  # noqa: S310
        size_bytes = len(answer.read())
    _say(f"page: {size_bytes} bytes")


def check_goal(client: Client) -> None:
    """A named goal ends with success, and the joints are somewhere else."""
    client.subscribe("/joint_states", "sensor_msgs/JointState")
    client.subscribe("/moveit_goal_result", "moveit_msgs/MoveItErrorCodes")
    start = client.next("/joint_states")["position"]
    client.publish("/moveit_goal_named", "std_msgs/String", {"data": "ready"})
    result = client.next("/moveit_goal_result")
    end = client.next("/joint_states")["position"]
    moved_rad = max(abs(after - before) for before, after in zip(start, end, strict=True))
    _say(f"goal: {result['val']} {result['message']}; a joint moved by {moved_rad:.2f} rad")
    if result["val"] != SUCCESS or moved_rad < MOVED_RAD:
        sys.exit(f"the arm should have moved by at least {MOVED_RAD} rad, and the answer been {SUCCESS}")


def check_straight_line(client: Client) -> None:
    """A straight line is planned, which takes libraries that a joint motion does not."""
    client.publish("/moveit_goal_named", "std_msgs/String", {"data": "home"})
    client.next("/moveit_goal_result")
    point = {"position": {"x": 0.33, "y": 0.0, "z": 0.2}, "orientation": {"w": 1.0}}
    answer = client.call("/compute_cartesian_path", {"waypoints": [point], "max_step": 0.01})
    points = answer["solution"]["joint_trajectory"]["points"]
    _say(f"straight line: {answer['error_code']['val']}, {len(points)} points")
    if answer["error_code"]["val"] != SUCCESS:
        sys.exit(f"the line should have been planned: {answer['error_code']}")


def _say(what: str) -> None:
    sys.stdout.write(f"{what}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
