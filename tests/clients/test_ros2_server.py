"""The connection of clients/ros2, without ROS: what the node sends to a real server, and in which order."""

import json
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from armbridge_ros2.interfaces import Joined, to_json
from armbridge_ros2.server import Server
from harness.server import RunningServer
from harness.waiting import wait_until

GRIPPER = Joined("/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand")
STOPS = [
    Joined("/stop", "std_msgs/msg/Empty"),
    Joined("/trajectory_execution_event", "std_msgs/msg/String"),
    Joined("/arm/stop", ""),
    Joined("/arm/emergency_stop", ""),
]


@pytest.fixture
def reports() -> list[str]:
    """What the connection reports."""
    return []


@pytest.fixture
def connection(server: RunningServer, reports: list[str]) -> Iterator[Server]:
    with connected(server, reports) as made:
        yield made


@contextmanager
def connected(server: RunningServer, reports: list[str]) -> Iterator[Server]:
    made = Server(f"ws://127.0.0.1:{server.port}", "", lambda topic, message: None, reports.append)
    made.start()
    wait_until(lambda: reports)
    yield made
    made.close()


def grip(connection: Server, stops: int, feedback: list[Any]) -> dict[str, Any]:
    goal = {"command": {"position": 0.5, "max_effort": 0.0}}
    return connection.send_goal(GRIPPER, goal, stops, feedback.append)[1].result(60.0)


def test_a_goal_gets_feedback_and_its_result(connection: Server) -> None:
    feedback: list[Any] = []
    end = grip(connection, connection.stops, feedback)
    assert (end["status"], end["values"]["reached_goal"]) == (4, True)
    assert feedback


def test_a_refused_call_is_reported_by_its_answer_alone(
    server: RunningServer, connection: Server, reports: list[str]
) -> None:
    with connected(server, []) as other:
        other.call("/arm/take_control", {}).result(60.0)
        with pytest.raises(RuntimeError, match="/arm/enable: client"):
            connection.call("/arm/enable", {}).result(60.0)
    connection.advertise("/stop", "std_msgs/msg/String")
    wait_until(lambda: len(reports) == 2)
    assert reports[1].startswith("refused: advertise")


def test_a_byte_of_rclpy_is_a_number_as_in_the_operation_of_an_object() -> None:
    assert to_json([b"\1", [b"\0", b"\2"]]) == [1, [0, 2]]


def test_lists_of_rclpy_are_numbers_as_in_the_triangles_of_a_mesh() -> None:
    assert json.dumps(to_json([np.array([0, 1, 2], np.uint32), array("d", [0.5])])) == "[[0, 1, 2], [0.5]]"


@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: stop.name)
def test_a_goal_is_not_sent_behind_a_stop_that_came_after_it(connection: Server, stop: Joined) -> None:
    came = connection.stops
    if stop.type:
        connection.advertise(stop.name, stop.type)
        assert connection.publish(stop.name, {"data": "stop"} if stop.type.endswith("String") else {})
    else:
        connection.call(stop.name, {}).result(60.0)
    with pytest.raises(RuntimeError, match="gripper_cmd: the goal was not sent: a stop came after it"):
        grip(connection, came, [])
    connection.call("/arm/reset_fault", {}).result(60.0)
    connection.call("/arm/enable", {}).result(60.0)
    assert grip(connection, connection.stops, [])["values"]["reached_goal"]
