"""Goals of clients that know only topics, one per message on ``/moveit_goal_*``: their status and result."""

import json
import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from planners.problem import MoveItErrorCode, PlanningFailure
from protocol.errors import MessageError
from protocol.publication import PublishedMessage
from robot.description.model import RobotModel
from server.diagnostic_values import LEVEL_ERROR, LEVEL_OK, key_values
from server.errors import RefusedError
from server.execution.confirmation import Confirmation
from server.execution.goal import Answer, Goal, GoalRequest, GoalState, Progress
from server.execution.motions import Joints
from server.execution.queue import GoalListener, GoalQueue
from server.graph.node import Node
from server.graph.permissions import CANCELLING, GOAL, STOP_EVENT, STOPPING, SWITCHING
from server.graph.topics import LocalNode
from server.moveit.goals.goal_messages import (
    GROUP_TOPIC,
    GROUP_TYPE,
    JOINTS_TOPIC,
    JOINTS_TYPE,
    NAMED_TOPIC,
    NAMED_TYPE,
    POSE_TOPIC,
    POSE_TYPE,
    GoalTranslator,
    suggestion,
)
from server.moveit.messages import Message

log = logging.getLogger("armbridge.goals")

RESULT_TOPIC = "/moveit_goal_result"
STATUS_TOPIC = "/moveit_goal_status"
CANCEL_TOPIC = "/moveit_goal_cancel"
STOP_TOPIC = "/stop"
EVENT_TOPIC = "/trajectory_execution_event"


class GoalStatusTopics(GoalListener):
    """Topics for the status of all goals and the results of those on ``/moveit_goal_*``; with joints, of one arm's."""

    def __init__(self, node: LocalNode, robot: RobotModel, joints: Joints | None = None) -> None:
        self._node = node
        self._robot = robot
        self._joints = joints
        self._sources = tuple(map(node.resolve, (NAMED_TOPIC, JOINTS_TOPIC, POSE_TOPIC)))
        self._node.advertise(RESULT_TOPIC, "moveit_msgs/MoveItErrorCodes")
        self._node.advertise(STATUS_TOPIC, "diagnostic_msgs/DiagnosticStatus")

    def on_progress(self, goal: Goal, progress: Progress) -> None:
        if self._is_here(goal):
            self._publish(goal, STATUS_TOPIC, _status(goal, progress, LEVEL_OK, {}))

    def on_answer(self, goal: Goal, answer: Answer) -> None:
        """Publish the final status of a goal, then the result of a goal from a topic."""
        if not self._is_here(goal):
            return
        status = final_status(goal, answer, self._robot)
        level = logging.INFO if answer.code is MoveItErrorCode.SUCCESS else logging.WARNING
        # A goal without permission is logged where the permission is checked, and others once, as goals of all arms.
        if goal.request.only_for is None and self._joints is None and not goal.unlogged:
            fields = {"goal": goal.goal_id, "client": str(goal.request.client), "code": answer.code.name}
            sentence = "goal %s from %s: %s: %s"
            values = goal.goal_id, goal.request.source, answer.code.name, status["message"]
            log.log(level, sentence, *values, extra=fields)
        self._publish(goal, STATUS_TOPIC, status)
        if goal.request.source in self._sources:
            source = f"{goal.request.source}#{goal.goal_id}"
            self._publish(goal, RESULT_TOPIC, {"val": int(answer.code), "message": status["message"], "source": source})

    def _is_here(self, goal: Goal) -> bool:
        """Return True for a goal that moves the arm, or was sent to it and refused."""
        joints, request = self._joints, goal.request
        return joints is None or bool(request.joints & joints) or request.source.startswith(self._node.resolve("/"))

    def _publish(self, goal: Goal, topic: str, message: Mapping[str, Any]) -> None:
        # Other clients wait for the end of goals of their own.
        if goal.request.only_for is None:
            self._node.publish(topic, message)
        else:
            self._node.tell(goal.request.only_for, topic, message)


def final_status(goal: Goal, answer: Answer, robot: RobotModel) -> Message:
    """Return the final status of a goal, with the goal that would have worked where one was found."""
    instead = suggestion(goal.request.message, answer.details, robot)
    message = answer.message if instead is None else instead.added_to(answer.message)
    succeeded = answer.code is MoveItErrorCode.SUCCESS
    details = {"code": str(int(answer.code)), **details_as_json(answer)}
    if instead is not None:
        # As in rosbridge's operations advertise and publish.
        suggested = {"topic": instead.topic, "type": instead.type_name, "msg": instead.msg}
        details["suggested_goal"] = json.dumps(suggested)
    done = Progress(GoalState.DONE, message, 1.0 if succeeded else 0.0)
    return _status(goal, done, LEVEL_OK if succeeded else LEVEL_ERROR, details)


def _status(goal: Goal, progress: Progress, level: int, details: Mapping[str, str]) -> Message:
    values = {
        "state": progress.state.value,
        "fraction": f"{progress.fraction:.3f}",
        "seconds_left": f"{progress.remaining_s:.2f}",
    }
    if "header" in goal.request.message:
        stamp = goal.request.message["header"]["stamp"]
        values["stamp"] = f"{stamp['sec']}.{stamp['nanosec']:09d}"
    return {
        "level": level,
        "name": goal.request.source,
        "message": progress.message,
        "hardware_id": goal.goal_id,
        "values": key_values({**values, **details}),
    }


def details_as_json(answer: Answer) -> dict[str, str]:
    return {name: json.dumps(value, default=str) for name, value in answer.details.items()}


class GoalTopics:
    """Topics by which goals are sent, their group is chosen, and they are cancelled or, of some joints, stopped."""

    def __init__(
        self,
        node: LocalNode,
        queue: GoalQueue,
        translator: GoalTranslator,
        confirmation: Confirmation,
        joints: Joints | None = None,
    ) -> None:
        self._node = node
        self._queue = queue
        self._translator = translator
        self._confirmation = confirmation
        self._joints = joints
        for goal_topic, type_name in ((NAMED_TOPIC, NAMED_TYPE), (JOINTS_TOPIC, JOINTS_TYPE), (POSE_TOPIC, POSE_TYPE)):
            self._take_goals(goal_topic, type_name)
        self._node.advertise(GROUP_TOPIC, GROUP_TYPE, latch=True)
        self._publish_group()
        # The driving client chooses the group.
        self._node.subscribe(GROUP_TOPIC, GROUP_TYPE, self._select_group, rule=SWITCHING)
        self._node.subscribe(CANCEL_TOPIC, "std_msgs/String", self._cancel, rule=CANCELLING)
        self._node.subscribe(STOP_TOPIC, "std_msgs/Empty", self._stop, rule=STOPPING)
        self._node.subscribe(EVENT_TOPIC, "std_msgs/String", self._on_event, rule=STOP_EVENT)

    def _take_goals(self, topic: str, type_name: str) -> None:
        source = self._node.resolve(topic)

        def deliver(published: PublishedMessage) -> None:
            message = published.msg
            try:
                motion = self._translator.motion(topic, message)
            except RefusedError as error:
                self._queue.reject(GoalRequest(source, message=message), error.failure)
                return
            for warning in motion.warnings:
                log.warning("%s: %s", source, warning)
            motion = replace(motion, confirm=self._confirmation.enabled)
            self._queue.submit(GoalRequest(source, motion, message, published.publisher))

        def reject_invalid(error: MessageError) -> None:
            failure = PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, str(error))
            self._queue.reject(GoalRequest(source), failure)

        def reject_unauthorized(message: Message, sender: Node, reason: str) -> None:
            failure = PlanningFailure(MoveItErrorCode.CONTROL_FAILED, reason)
            self._queue.reject(GoalRequest(source, message=message, only_for=sender), failure)

        self._node.subscribe(topic, type_name, deliver, reject_invalid, reject_unauthorized, rule=GOAL)

    def _select_group(self, published: PublishedMessage) -> None:
        """Choose the group of goals to come; publish the present one after a name that is none."""
        if published.publisher is self._node:
            return
        try:
            self._translator.select_group(published.msg["data"])
        except RefusedError as error:
            request = GoalRequest(self._node.resolve(GROUP_TOPIC), message=published.msg)
            self._queue.reject(request, error.failure)
        self._publish_group()

    def _publish_group(self) -> None:
        self._node.publish(GROUP_TOPIC, {"data": self._translator.group.name})

    def _cancel(self, published: PublishedMessage) -> None:
        self._queue.cancel(published.msg["data"], f"cancelled by {self._node.resolve(CANCEL_TOPIC)}")

    def _stop(self, _message: object) -> None:
        self._queue.stop(f"stopped by {self._node.resolve(STOP_TOPIC)}", self._joints)

    def _on_event(self, published: PublishedMessage) -> None:
        event = published.msg["data"]
        if event == "stop":
            self._queue.stop(f"stopped by {self._node.resolve(EVENT_TOPIC)}", self._joints)
        else:
            log.warning("%s: ignored the event %r; only 'stop' is known", EVENT_TOPIC, event)
