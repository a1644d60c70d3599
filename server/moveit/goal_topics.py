"""Goal topics: one goal per message on ``/moveit_goal_*``, its confirmation, its status and its result."""

from __future__ import annotations

import asyncio
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
from server.errors import RefusedError
from server.execution.motions import Motion, PlannedMotion
from server.execution.queue import Answer, GoalQueue, GoalState, Progress, QueuedGoal
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.goal_messages import (
    JOINTS_TOPIC,
    JOINTS_TYPE,
    NAMED_TOPIC,
    NAMED_TYPE,
    POSE_TOPIC,
    POSE_TYPE,
    GoalTranslator,
    Message,
    suggestion,
)

log = logging.getLogger("armbridge.goals")

RESULT_TOPIC = "/moveit_goal_result"
STATUS_TOPIC = "/moveit_goal_status"
CANCEL_TOPIC = "/moveit_goal_cancel"
CONFIRM_TOPIC = "/moveit_goal_confirm"
CONFIRM_MODE_SERVICE = "/moveit_goal_confirm_mode"
STOP_TOPIC = "/stop"
EVENT_TOPIC = "/trajectory_execution_event"

# diagnostic_msgs/DiagnosticStatus levels.
LEVEL_OK, LEVEL_ERROR = 0, 2

Translate: TypeAlias = Callable[[Message], PlannedMotion]


class Confirmation:
    """Gate between plan and motion: the arm moves when a user confirms the plan.

    Args:
        graph: where topic and service are.
        wanted: true if goals on ``/moveit_goal_*`` wait at the gate.
        timeout_s: limit of their wait [s].

    Attributes:
        wanted: as given; the service changes it for goals to come.
    """

    def __init__(self, graph: Graph, *, wanted: bool, timeout_s: float) -> None:
        self._graph = graph
        self._node = Node("confirmation")
        self._decision: asyncio.Future[bool] | None = None
        self._timeout_s = timeout_s
        self.wanted = wanted

    def open(self) -> None:
        """Subscribe to the topic, and offer the service."""
        subscriber = Subscriber(
            lambda publication: self._take_decision(go=publication.msg["data"]),
            lambda error: log.warning("%s: %s", CONFIRM_TOPIC, error),
        )
        self._graph.subscribe(self._node, CONFIRM_TOPIC, "std_msgs/Bool", subscriber)
        self._graph.services.offer(self._node, CONFIRM_MODE_SERVICE, "std_srvs/SetBool", self._set_mode)

    async def wait(self) -> Answer | None:
        """Wait for the decision; return None to go on, else the goal's answer."""
        self._decision = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(self._timeout_s):
                go = await self._decision
        except TimeoutError:
            message = f"planned, but not confirmed on {CONFIRM_TOPIC} within {self._timeout_s:g} s"
            return Answer(MoveItErrorCode.TIMED_OUT, message)
        finally:
            self._decision = None
        return None if go else Answer(MoveItErrorCode.PREEMPTED, f"planned, and discarded by {CONFIRM_TOPIC}")

    def _take_decision(self, *, go: bool) -> None:
        if self._decision is None or self._decision.done():
            log.warning("%s: ignored, no goal waits for it", CONFIRM_TOPIC)
        else:
            self._decision.set_result(go)

    def _set_mode(self, request: dict[str, Any]) -> dict[str, Any]:
        self.wanted = request["data"]
        said = f"wait for a message on {CONFIRM_TOPIC}" if self.wanted else "are carried out at once"
        return {"success": True, "message": f"goals on /moveit_goal_* {said}"}


class GoalStatusTopics:
    """Topics for the status of all goals and the results of those on ``/moveit_goal_*``.

    Args:
        graph: where the topics are.
        node: publishes.
        robot: the arm, for suggestions.
    """

    def __init__(self, graph: Graph, node: Node, robot: RobotModel) -> None:
        self._graph = graph
        self._node = node
        self._robot = robot

    def open(self) -> None:
        """Advertise the topics."""
        self._graph.advertise(self._node, RESULT_TOPIC, "moveit_msgs/MoveItErrorCodes")
        self._graph.advertise(self._node, STATUS_TOPIC, "diagnostic_msgs/DiagnosticStatus")

    def publish_progress(self, goal: QueuedGoal[Motion], progress: Progress) -> None:
        """Publish the progress of a goal, whatever topic or action it came by."""
        self._publish_status(goal, progress, LEVEL_OK, {})

    def publish_answer(self, goal: QueuedGoal[Motion], answer: Answer) -> None:
        """Log the end of a goal and publish its final status, then the one result of a goal from a topic."""
        instead = suggestion(goal.message, answer.details, self._robot)
        message = answer.message if instead is None else f"{answer.message}; what would work: {instead.words}"
        succeeded = answer.code is MoveItErrorCode.SUCCESS
        level = logging.INFO if succeeded else logging.WARNING
        # A goal without permission is logged where the permission is checked.
        if goal.only_for is None:
            log.log(level, "goal %s from %s: %s: %s", goal.goal_id, goal.source, answer.code.name, message)
        details = {"code": str(int(answer.code))}
        details |= {name: json.dumps(value, default=str) for name, value in answer.details.items()}
        if instead is not None:
            details["suggested_goal"] = json.dumps(instead.as_data())
        done = Progress(GoalState.DONE, message, 1.0 if succeeded else 0.0)
        self._publish_status(goal, done, LEVEL_OK if succeeded else LEVEL_ERROR, details)
        if goal.source not in (NAMED_TOPIC, JOINTS_TOPIC, POSE_TOPIC):
            return
        result = {"val": int(answer.code), "message": message, "source": f"{goal.source}#{goal.goal_id}"}
        self._publish(goal, RESULT_TOPIC, result)

    def _publish_status(
        self, goal: QueuedGoal[Motion], progress: Progress, level: int, details: Mapping[str, str]
    ) -> None:
        values = {
            "state": progress.state.value,
            "fraction": f"{progress.fraction:.3f}",
            "seconds_left": f"{progress.remaining_s:.2f}",
        }
        if "header" in goal.message:
            stamp = goal.message["header"]["stamp"]
            values["stamp"] = f"{stamp['sec']}.{stamp['nanosec']:09d}"
        status = {
            "level": level,
            "name": goal.source,
            "message": progress.message,
            "hardware_id": goal.goal_id,
            "values": key_values({**values, **details}),
        }
        self._publish(goal, STATUS_TOPIC, status)

    def _publish(self, goal: QueuedGoal[Motion], topic: str, message: Mapping[str, Any]) -> None:
        # Other clients wait for the end of goals of their own.
        if goal.only_for is None:
            self._graph.publish(self._node, topic, message)
        else:
            self._graph.tell(goal.only_for, topic, message)


class GoalTopics:
    """Topics by which goals are sent, cancelled and stopped.

    Args:
        graph: where the topics are.
        node: subscribes.
        queue: takes the goals.
        translator: reads their messages.
        confirmation: decides if goals are to be confirmed.
    """

    def __init__(
        self,
        graph: Graph,
        node: Node,
        queue: GoalQueue[Motion],
        translator: GoalTranslator,
        confirmation: Confirmation,
    ) -> None:
        self._graph = graph
        self._node = node
        self._queue = queue
        self._translator = translator
        self._confirmation = confirmation

    def open(self) -> None:
        """Subscribe to the topics."""
        self._take_goals(NAMED_TOPIC, NAMED_TYPE, self._translator.named)
        self._take_goals(JOINTS_TOPIC, JOINTS_TYPE, self._translator.joints)
        self._take_goals(POSE_TOPIC, POSE_TYPE, self._translator.pose)
        self._graph.subscribe(self._node, CANCEL_TOPIC, "std_msgs/String", Subscriber(self._cancel))
        self._graph.subscribe(self._node, STOP_TOPIC, "std_msgs/Empty", Subscriber(self._stop))
        self._graph.subscribe(self._node, EVENT_TOPIC, "std_msgs/String", Subscriber(self._on_event))

    def _take_goals(self, topic: str, type_name: str, translate: Translate) -> None:
        def deliver(publication: Publication) -> None:
            message = publication.msg
            try:
                motion = translate(message)
            except RefusedError as error:
                self._queue.reject(topic, error.failure, message)
                return
            for warning in motion.warnings:
                log.warning("%s: %s", topic, warning)
            self._queue.submit(topic, replace(motion, confirm=self._confirmation.wanted), message=message)

        def reject_invalid(error: MessageError) -> None:
            self._queue.reject(topic, PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, str(error)))

        def reject_unauthorized(message: Message, sender: Node, reason: str) -> None:
            failure = PlanningFailure(MoveItErrorCode.CONTROL_FAILED, reason)
            self._queue.reject(topic, failure, message, only_for=sender)

        subscriber = Subscriber(deliver, reject_invalid, reject_unauthorized)
        self._graph.subscribe(self._node, topic, type_name, subscriber)

    def _cancel(self, publication: Publication) -> None:
        self._queue.cancel(publication.msg["data"], f"cancelled by {CANCEL_TOPIC}")

    def _stop(self, _publication: Publication) -> None:
        self._queue.stop(f"stopped by {STOP_TOPIC}")

    def _on_event(self, publication: Publication) -> None:
        event = publication.msg["data"]
        if event == "stop":
            self._queue.stop(f"stopped by {EVENT_TOPIC}")
        else:
            log.warning("%s: ignored the event %r; only 'stop' is known", EVENT_TOPIC, event)
