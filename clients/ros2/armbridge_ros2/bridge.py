"""The node: ``ros2 run armbridge_ros2 bridge --ros-args -p url:=ws://127.0.0.1:9090``."""

from __future__ import annotations

import concurrent.futures
import os
import signal
import threading
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from armbridge_ros2.interfaces import (
    ACTIONS,
    FROM_SERVER,
    SCENE,
    SERVICES,
    TO_SERVER,
    Joined,
    fill,
    refused,
    ros_class,
    to_json,
)
from armbridge_ros2.server import STOPS, Server

ANSWER_TIMEOUT_S = 60.0
# Calls and goals that wait for the server hold a thread each; topics and services that stop have threads of their own.
MAX_WAITING = 16
OTHER_THREADS = 4
# action_msgs/GoalStatus
SUCCEEDED, CANCELED = 4, 5
CANCEL_PERIOD_S = 0.05
LONGEST_WAIT_S = 0.5
QUEUE = 10
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Bridge(Node):
    """An armbridge server as a robot of the ROS graph.

    Parameter of the node: ``url`` (``ws://127.0.0.1:9090``). A token is read from the environment: ARMBRIDGE_TOKEN.
    """

    def __init__(self) -> None:
        super().__init__("armbridge")
        # Read once: a node that took another value later would go on with the first.
        fixed = ParameterDescriptor(read_only=True)
        url: str = self.declare_parameter("url", "ws://127.0.0.1:9090", fixed).value
        self._from_server: dict[str, Any] = {}
        self._action_servers: list[ActionServer[Any, Any, Any]] = []
        self._left_out: dict[str, list[str]] = {}
        self._connection = Server(url, os.environ.get("ARMBRIDGE_TOKEN", ""), self._on_message, self._report)
        # One after the other: of a goal and a stop that wait together the stop, the last of the list, goes last.
        self._in_order = MutuallyExclusiveCallbackGroup()
        self._objects_in_order = MutuallyExclusiveCallbackGroup()
        self._side_by_side = ReentrantCallbackGroup()
        for topic in FROM_SERVER:
            self._join(topic, self._take_topic)
        for topic in TO_SERVER:
            self._join(topic, self._offer_topic)
        self._waiting = threading.BoundedSemaphore(MAX_WAITING)
        for service in SERVICES:
            self._join(service, self._offer_service)
        for action in ACTIONS:
            self._join(action, self._offer_action)
        for package, names in self._left_out.items():
            self.get_logger().info(f"{package} is not installed here; left out: {', '.join(names)}")
        self._connection.start()

    def close(self) -> None:
        """Leave the server and the graph."""
        self._connection.close()
        self.destroy_node()

    def _report(self, sentence: str) -> None:
        self.get_logger().info(sentence)

    def _log_refusal(self, joined: Joined, sentence: str) -> None:
        self.get_logger().error(sentence if joined.name in sentence else f"{joined.name}: {sentence}")

    def _join(self, joined: Joined, join: Any) -> None:
        try:
            message_class = ros_class(joined.type)
        except ImportError:
            self._left_out.setdefault(joined.type.split("/")[0], []).append(joined.name)
            return
        join(joined, message_class)

    def _take_topic(self, topic: Joined, message_class: Any) -> None:
        qos = LATCHED if topic.latched else QUEUE
        self._from_server[topic.name] = self.create_publisher(message_class, topic.name, qos)
        self._connection.subscribe(topic.name, topic.type)

    def _offer_topic(self, topic: Joined, message_class: Any) -> None:
        def pass_on(message: Any) -> None:
            if not self._connection.publish(topic.name, to_json(message)):
                self.get_logger().warning(f"{topic.name}: a message is lost: there is no connection to the server")

        self._connection.advertise(topic.name, topic.type)
        # A mesh of 100,000 triangles takes half a second, for which no stop waits.
        group = self._objects_in_order if topic in SCENE else self._in_order
        # Reliable, as publishers are unless they choose otherwise: no stop is lost on the way.
        self.create_subscription(message_class, topic.name, pass_on, QUEUE, callback_group=group)

    def _offer_service(self, service: Joined, service_class: Any) -> None:
        def ask(request: Any, response: Any) -> Any:
            try:
                return fill(response, self._answer(service.name, request))
            except (ConnectionError, RuntimeError, concurrent.futures.TimeoutError) as error:
                sentence = str(error) or f"no answer within {ANSWER_TIMEOUT_S:g} s"
                self._log_refusal(service, sentence)
                # A ROS service has no way to refuse.
                return refused(response, sentence)

        self.create_service(service_class, service.name, ask, callback_group=self._side_by_side)

    def _answer(self, service: str, request: Any) -> dict[str, Any]:
        takes_turn = service not in STOPS
        if takes_turn and not self._waiting.acquire(blocking=False):
            raise RuntimeError(f"{MAX_WAITING} calls and goals wait for the server: call again later")
        try:
            return self._connection.call(service, to_json(request)).result(ANSWER_TIMEOUT_S)
        finally:
            if takes_turn:
                self._waiting.release()

    def _offer_action(self, action: Joined, action_class: Any) -> None:
        def take(_goal: Any) -> GoalResponse:
            if self._waiting.acquire(blocking=False):
                return GoalResponse.ACCEPT
            self.get_logger().error(f"{action.name}: {MAX_WAITING} calls and goals wait for the server")
            return GoalResponse.REJECT

        def execute(goal: Any, stops: int) -> Any:
            try:
                return self._execute(action, action_class, goal, stops)
            finally:
                self._waiting.release()

        def accepted(goal: Any) -> None:
            # The goal is carried out later, on another thread.
            stops = self._connection.stops
            goal.execute(lambda goal: execute(goal, stops))

        server = ActionServer(
            self,
            action_class,
            action.name,
            execute_callback=accepted,  # rclpy wants a result; it takes the result of `accepted`
            goal_callback=take,
            handle_accepted_callback=accepted,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=self._side_by_side,
        )
        self._action_servers.append(server)

    def _execute(self, action: Joined, action_class: Any, goal: Any, stops: int) -> Any:
        """Carry a goal out on the server, however long it takes: the server limits a goal's time."""

        def on_feedback(values: dict[str, Any]) -> None:
            if goal.is_active:
                goal.publish_feedback(fill(action_class.Feedback(), values))

        number, answer = self._connection.send_goal(action, to_json(goal.request), stops, on_feedback)
        result = action_class.Result()
        cancelled = False
        try:
            while not concurrent.futures.wait((answer,), CANCEL_PERIOD_S).done:
                if goal.is_cancel_requested and not cancelled:
                    self._connection.cancel_goal(action.name, number)
                    cancelled = True
            end = answer.result()
        except (ConnectionError, RuntimeError) as error:
            self._log_refusal(action, str(error))
            goal.abort()
            return refused(result, str(error))
        fill(result, end["values"])
        if end["status"] == SUCCEEDED:
            goal.succeed()
        elif end["status"] == CANCELED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _on_message(self, topic: str, serialized: bytes) -> None:
        # The bytes are ROS 2's already: no field is read.
        self._from_server[topic].publish(serialized)


def main() -> None:
    """Run the node until Ctrl+C or SIGTERM."""
    # rclpy's own handlers end the graph under messages that still come, and on a busy machine a wait of rclpy 9.1 may
    # miss them and last for ever: signals are looked at between bounded waits, and the server is left before the graph.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    ended = threading.Event()
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, lambda *_: ended.set())
    bridge = Bridge()
    executor = MultiThreadedExecutor(MAX_WAITING + OTHER_THREADS)
    executor.add_node(bridge)
    try:
        while not ended.is_set():
            executor.spin_once(timeout_sec=LONGEST_WAIT_S)
    finally:
        bridge.close()
        executor.shutdown(LONGEST_WAIT_S)
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
