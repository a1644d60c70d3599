"""Topics of each action, as ROS 2 has them: ``<action>/_action/status`` and ``<action>/_action/feedback``.

The node that offers the action publishes them. The status topic is latched; it has the goals that are worked on, and
of ended ones for a while (rcl_action, action_server.c). Feedback is published while somebody listens.
"""

from __future__ import annotations

import logging
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from server.errors import GraphError
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.node import Node

if TYPE_CHECKING:
    from server.graph.topics import Graph

log = logging.getLogger("armbridge.graph")

STATUS, FEEDBACK = "/_action/status", "/_action/feedback"
STATUS_TYPE = "action_msgs/msg/GoalStatusArray"

# action_msgs/GoalStatus, of goals that have not ended.
EXECUTING, CANCELING = 2, 3

# rcl_action's default result_timeout: time for which the status of an ended goal is still published [s].
ENDED_KEPT_S = 10.0

# Far more than anybody waits for; of more goals the newest are published, so that a flood of goals costs little each.
MAX_PUBLISHED = 100


@dataclass(slots=True)
class _TrackedStatus:
    goal_info: Mapping[str, Any]
    status: int = EXECUTING
    ended_s: float | None = None


class ActionTopics:
    """Topics of all actions; followed by :class:`server.graph.actions.Actions`."""

    def __init__(self, topics: Graph, clock: Callable[[], float]) -> None:
        self._topics = topics
        self._clock = clock
        # By action, the oldest goal first.
        self._goals: dict[str, dict[ActionGoal, _TrackedStatus]] = {}

    def open(self, node: Node, action: str, type_name: str) -> None:
        self._goals[action] = {}
        feedback_type = f"{type_name}_FeedbackMessage"
        try:
            self._topics.advertise(node, action + STATUS, STATUS_TYPE, latch=True)
            # A type that is relayed without being known has none.
            if self._topics.message_types.registry.knows(feedback_type):
                self._topics.advertise(node, action + FEEDBACK, feedback_type)
        except GraphError as error:
            # Somebody has made a topic of this name; the action works without.
            log.warning("action %s: its topics are not published: %s", action, error)

    def close(self, node: Node, action: str) -> None:
        self._goals.pop(action, None)
        self._topics.unadvertise(node, action + STATUS)
        self._topics.unadvertise(node, action + FEEDBACK)

    def follow(self, node: Node, goal: ActionGoal) -> None:
        """Tell of a goal that its provider is just getting, until it ends."""
        goal_id = {"uuid": b64encode(goal.goal_id).decode()}
        stamp = self._topics.message_types.now().as_message()
        tracked = _TrackedStatus({"goal_id": goal_id, "stamp": stamp})
        self._goals[goal.action][goal] = tracked

        def tell(status: int, ended_s: float | None = None) -> None:
            tracked.status, tracked.ended_s = status, ended_s
            self._publish_status(node, goal.action)

        def tell_feedback(values: Mapping[str, Any]) -> None:
            topic = goal.action + FEEDBACK
            if self._is_open(node, topic, f"{goal.type_name}_FeedbackMessage") and self._topics.subscribers(topic):
                self._topics.publish(node, topic, {"goal_id": goal_id, "feedback": values}, prevalidated=True)

        def tell_end(status: int) -> None:
            if status == GoalStatus.UNKNOWN:
                # Never taken on, which in ROS has no status.
                self._goals.get(goal.action, {}).pop(goal, None)
            tell(status, self._clock())

        tell(EXECUTING)
        goal.on_every_feedback(tell_feedback)
        goal.when_canceled(lambda: tell(CANCELING))
        goal.when_ended(lambda result: tell_end(int(result.status)))

    def _publish_status(self, node: Node, action: str) -> None:
        goals = self._goals.get(action)
        if goals is None or not self._is_open(node, action + STATUS, STATUS_TYPE):
            return
        ended = {goal: each.ended_s for goal, each in goals.items() if each.ended_s is not None}
        for place, (goal, ended_s) in enumerate(ended.items()):
            if ended_s <= self._clock() - ENDED_KEPT_S or place < len(ended) - MAX_PUBLISHED:
                del goals[goal]
        newest = list(goals.values())[-MAX_PUBLISHED:]
        statuses = [{"goal_info": each.goal_info, "status": each.status} for each in newest]
        self._topics.publish(node, action + STATUS, {"status_list": statuses}, prevalidated=True)

    def _is_open(self, node: Node, topic: str, type_name: str) -> bool:
        """Return True for a topic of the node's action; a client that offers one may have made its own of this name."""
        return self._topics.topic_type(topic) == type_name and node in self._topics.publishers(topic)
