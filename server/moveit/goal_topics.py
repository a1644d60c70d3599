"""The simple layer: a goal a message on ``/moveit_goal_*``, news and one answer for each on topics of their own."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.errors import MessageError
from protocol.publication import Publication
from server.goal_queue import Answer, GoalQueue, GoalState, Progress, QueuedGoal
from server.graph import Graph, Subscriber
from server.moveit.goals import GoalTranslator, MotionRequest
from server.node import Node

log = logging.getLogger("armbridge.goals")

RESULT_TOPIC = "/moveit_goal_result"
STATUS_TOPIC = "/moveit_goal_status"
STOP_TOPIC = "/stop"
EVENT_TOPIC = "/trajectory_execution_event"

# diagnostic_msgs/DiagnosticStatus levels.
LEVEL_OK, LEVEL_ERROR = 0, 2


class GoalTopics:
    """Takes goals from topics and tells how they go.

    Args:
        graph: where the topics are.
        translator: reads the goal messages.
    """

    def __init__(self, graph: Graph, translator: GoalTranslator) -> None:
        self._graph = graph
        self._node = Node("moveit")
        self._translations: Mapping[str, tuple[str, Callable[[Mapping[str, Any]], MotionRequest | PlanningFailure]]] = {
            "/moveit_goal_named": ("std_msgs/String", translator.named),
            "/moveit_goal_joints": ("sensor_msgs/JointState", translator.joints),
            "/moveit_goal_pose": ("geometry_msgs/PoseStamped", translator.pose),
        }

    def open(self, queue: GoalQueue[MotionRequest]) -> None:
        """Advertise and subscribe."""
        graph, node = self._graph, self._node
        graph.advertise(node, RESULT_TOPIC, "moveit_msgs/MoveItErrorCodes")
        graph.advertise(node, STATUS_TOPIC, "diagnostic_msgs/DiagnosticStatus")
        for topic, (type_name, translate) in self._translations.items():
            graph.subscribe(node, topic, type_name, self._goal_subscriber(queue, topic, translate))
        stop = Subscriber(lambda _: queue.stop(f"stopped by {STOP_TOPIC}"))
        graph.subscribe(node, STOP_TOPIC, "std_msgs/Empty", stop)
        event = Subscriber(lambda publication: _on_event(queue, publication))
        graph.subscribe(node, EVENT_TOPIC, "std_msgs/String", event)

    def _goal_subscriber(
        self,
        queue: GoalQueue[MotionRequest],
        topic: str,
        translate: Callable[[Mapping[str, Any]], MotionRequest | PlanningFailure],
    ) -> Subscriber:
        def deliver(publication: Publication) -> None:
            request = translate(publication.msg)
            if isinstance(request, PlanningFailure):
                queue.refuse(topic, request)
                return
            for warning in request.warnings:
                log.warning("%s: %s", topic, warning)
            queue.submit(topic, request)

        def refused(error: MessageError) -> None:
            queue.refuse(topic, PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, str(error)))

        return Subscriber(deliver, refused)

    def on_progress(self, goal: QueuedGoal[MotionRequest], progress: Progress) -> None:
        """Publish the news of a goal."""
        self._publish_status(goal, progress, LEVEL_OK)

    def on_answer(self, goal: QueuedGoal[MotionRequest], answer: Answer) -> None:
        """Publish the end of a goal: its last status, then its one result."""
        succeeded = answer.code is MoveItErrorCode.SUCCESS
        log.log(
            logging.INFO if succeeded else logging.WARNING,
            "goal %s from %s: %s: %s",
            goal.goal_id,
            goal.source,
            answer.code.name,
            answer.message,
        )
        level = LEVEL_OK if succeeded else LEVEL_ERROR
        self._publish_status(goal, Progress(GoalState.DONE, answer.message, 1.0 if succeeded else 0.0), level)
        result = {
            "val": int(answer.code),
            "message": answer.message,
            "source": f"{goal.source}#{goal.goal_id}",
        }
        self._graph.publish(self._node, RESULT_TOPIC, result)

    def _publish_status(self, goal: QueuedGoal[MotionRequest], progress: Progress, level: int) -> None:
        values = {
            "state": progress.state.value,
            "fraction": f"{progress.fraction:.3f}",
            "seconds_left": f"{progress.remaining_s:.2f}",
        }
        status = {
            "level": level,
            "name": goal.source,
            "message": progress.message,
            "hardware_id": goal.goal_id,
            "values": [{"key": key, "value": value} for key, value in values.items()],
        }
        self._graph.publish(self._node, STATUS_TOPIC, status)


def _on_event(queue: GoalQueue[MotionRequest], publication: Publication) -> None:
    event = publication.msg["data"]
    if event == "stop":
        queue.stop(f"stopped by {EVENT_TOPIC}")
    else:
        log.warning("%s: ignored the event %r; only 'stop' is known", EVENT_TOPIC, event)
