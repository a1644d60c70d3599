"""``/monitored_planning_scene``: what has changed of the scene, and the whole of it for who comes later."""

from __future__ import annotations

import time
from collections.abc import Callable

from robot.description.model import RobotModel
from server.execution.current_state import CurrentState
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.scene.messages import EVERYTHING, difference, scene_message
from server.moveit.scene.state import SceneState
from server.timers import CallLater, Timer, call_later

TOPIC = "/monitored_planning_scene"


class MonitoredScene:
    """Publishes differences; a new subscriber gets the whole scene first.

    Args:
        graph: where the topic is.
        node: who publishes.
        robot: the arm.
        state: the scene.
        rate_hz: changes that come faster are told together [Hz].
        clock: monotonic time [s].
        call_later: does something after a delay.
    """

    def __init__(
        self,
        graph: Graph,
        node: Node,
        robot: RobotModel,
        state: SceneState,
        rate_hz: float,
        clock: Callable[[], float] = time.monotonic,
        call_later: CallLater = call_later,
    ) -> None:
        self._graph = graph
        self._node = node
        self._robot = robot
        self._state = state
        self._clock = clock
        self._call_later = call_later
        self._told = state.contents
        self._period_s = 1.0 / rate_hz
        self._told_at_s = clock() - self._period_s
        self._timer: Timer | None = None
        state.on_change(self._changed)

    def open(self, current: CurrentState) -> None:
        """Advertise the topic and tell the whole scene.

        Args:
            current: where the joints are.
        """
        self._current = current
        self._graph.advertise(self._node, TOPIC, "moveit_msgs/PlanningScene")
        self._latch()

    def close(self) -> None:
        """Tell no more."""
        if self._timer is not None:
            self._timer.cancel()

    def _changed(self) -> None:
        if self._timer is None:
            due_s = self._told_at_s + self._period_s
            self._timer = self._call_later(max(0.0, due_s - self._clock()), self._tell)

    def _tell(self) -> None:
        self._timer, self._told_at_s = None, self._clock()
        before, self._told = self._told, self._state.contents
        if before != self._told:
            self._graph.publish(self._node, TOPIC, difference(before, self._told, self._robot))
            self._latch()

    def _latch(self) -> None:
        state = self._current.message()
        self._graph.latch(TOPIC, scene_message(self._told, self._robot, state, EVERYTHING))
