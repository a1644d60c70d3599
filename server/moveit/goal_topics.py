"""The simple layer: a goal a message on ``/moveit_goal_*``, news and one answer for each on topics of their own."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.errors import MessageError
from protocol.publication import Publication
from robot.description.model import RobotModel
from server.arm.topics import key_values
from server.goal_queue import Answer, GoalQueue, GoalState, Progress, QueuedGoal
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.confirmation import Confirmation
from server.moveit.goals import GoalTranslator
from server.moveit.motions import Motion, PlannedMotion
from server.moveit.suggestions import (
    JOINTS_TOPIC,
    JOINTS_TYPE,
    NAMED_TOPIC,
    NAMED_TYPE,
    POSE_TOPIC,
    POSE_TYPE,
    suggestion,
)

log = logging.getLogger("armbridge.goals")

RESULT_TOPIC = "/moveit_goal_result"
STATUS_TOPIC = "/moveit_goal_status"
CANCEL_TOPIC = "/moveit_goal_cancel"
STOP_TOPIC = "/stop"
EVENT_TOPIC = "/trajectory_execution_event"

# diagnostic_msgs/DiagnosticStatus levels.
LEVEL_OK, LEVEL_ERROR = 0, 2

Translate: TypeAlias = Callable[[Mapping[str, Any]], PlannedMotion | PlanningFailure]


class GoalTopics:
    """Takes goals from topics and tells how they go.

    Args:
        graph: where the topics are.
        robot: the arm.
        confirmation: says whether goals are to be confirmed.
    """

    def __init__(self, graph: Graph, robot: RobotModel, confirmation: Confirmation) -> None:
        self._graph = graph
        self._robot = robot
        self._confirmation = confirmation
        self._node = Node("moveit")

    def open(self, queue: GoalQueue[Motion], translator: GoalTranslator) -> None:
        """Advertise and subscribe.

        Args:
            queue: where the goals go.
            translator: reads the goal messages.
        """
        graph, node = self._graph, self._node
        graph.advertise(node, RESULT_TOPIC, "moveit_msgs/MoveItErrorCodes")
        graph.advertise(node, STATUS_TOPIC, "diagnostic_msgs/DiagnosticStatus")
        self._take_goals(queue, NAMED_TOPIC, NAMED_TYPE, translator.named)
        self._take_goals(queue, JOINTS_TOPIC, JOINTS_TYPE, translator.joints)
        self._take_goals(queue, POSE_TOPIC, POSE_TYPE, translator.pose)
        cancel = Subscriber(lambda publication: queue.cancel(publication.msg["data"], f"cancelled by {CANCEL_TOPIC}"))
        graph.subscribe(node, CANCEL_TOPIC, "std_msgs/String", cancel)
        stop = Subscriber(lambda _: queue.stop(f"stopped by {STOP_TOPIC}"))
        graph.subscribe(node, STOP_TOPIC, "std_msgs/Empty", stop)
        event = Subscriber(lambda publication: _on_event(queue, publication))
        graph.subscribe(node, EVENT_TOPIC, "std_msgs/String", event)

    def _take_goals(self, queue: GoalQueue[Motion], topic: str, type_name: str, translate: Translate) -> None:
        def deliver(publication: Publication) -> None:
            asked = publication.msg
            motion = translate(asked)
            if isinstance(motion, PlanningFailure):
                queue.refuse(topic, motion, asked)
                return
            for warning in motion.warnings:
                log.warning("%s: %s", topic, warning)
            queue.submit(topic, replace(motion, confirm=self._confirmation.wanted), asked=asked)

        def refused(error: MessageError) -> None:
            queue.refuse(topic, PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, str(error)))

        def turned_away(asked: Mapping[str, Any], sender: Node, reason: str) -> None:
            queue.refuse(topic, PlanningFailure(MoveItErrorCode.CONTROL_FAILED, reason), asked, only_for=sender)

        self._graph.subscribe(self._node, topic, type_name, Subscriber(deliver, refused, turned_away))

    def on_progress(self, goal: QueuedGoal[Motion], progress: Progress) -> None:
        """Publish the news of a goal, by whatever way it came."""
        self._publish_status(goal, progress, LEVEL_OK, {})

    def on_answer(self, goal: QueuedGoal[Motion], answer: Answer) -> None:
        """Log the end of a goal and publish its last status, then the one result of one that came by a topic."""
        instead = suggestion(goal.asked, answer.details, self._robot)
        message = answer.message if instead is None else f"{answer.message}; what would work: {instead.words}"
        succeeded = answer.code is MoveItErrorCode.SUCCESS
        level = logging.INFO if succeeded else logging.WARNING
        # What one client may not do is logged where it is refused.
        if goal.only_for is None:
            log.log(level, "goal %s from %s: %s: %s", goal.goal_id, goal.source, answer.code.name, message)
        found = {"code": str(int(answer.code))}
        found |= {name: json.dumps(value, default=str) for name, value in answer.details.items()}
        if instead is not None:
            found["suggested_goal"] = json.dumps(instead.as_data())
        done = Progress(GoalState.DONE, message, 1.0 if succeeded else 0.0)
        self._publish_status(goal, done, LEVEL_OK if succeeded else LEVEL_ERROR, found)
        if goal.source not in (NAMED_TOPIC, JOINTS_TOPIC, POSE_TOPIC):
            return
        result = {"val": int(answer.code), "message": message, "source": f"{goal.source}#{goal.goal_id}"}
        self._publish(goal, RESULT_TOPIC, result)

    def _publish_status(
        self, goal: QueuedGoal[Motion], progress: Progress, level: int, found: Mapping[str, str]
    ) -> None:
        values = {
            "state": progress.state.value,
            "fraction": f"{progress.fraction:.3f}",
            "seconds_left": f"{progress.remaining_s:.2f}",
        }
        if "header" in goal.asked:
            stamp = goal.asked["header"]["stamp"]
            values["stamp"] = f"{stamp['sec']}.{stamp['nanosec']:09d}"
        status = {
            "level": level,
            "name": goal.source,
            "message": progress.message,
            "hardware_id": goal.goal_id,
            "values": key_values({**values, **found}),
        }
        self._publish(goal, STATUS_TOPIC, status)

    def _publish(self, goal: QueuedGoal[Motion], topic: str, message: Mapping[str, Any]) -> None:
        # It is no news to others, who wait for the end of goals of their own.
        if goal.only_for is None:
            self._graph.publish(self._node, topic, message)
        else:
            self._graph.tell(goal.only_for, topic, message)


def _on_event(queue: GoalQueue[Motion], publication: Publication) -> None:
    event = publication.msg["data"]
    if event == "stop":
        queue.stop(f"stopped by {EVENT_TOPIC}")
    else:
        log.warning("%s: ignored the event %r; only 'stop' is known", EVENT_TOPIC, event)
