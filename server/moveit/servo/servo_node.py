"""What MoveIt Servo's clients talk to: topics for commands, a status, and the services of both its generations."""

from __future__ import annotations

import time
from collections.abc import Callable, Coroutine
from typing import Any

from planners.pool import PlannerPool
from planners.problem import PlanningFailure
from planners.servo.question import ServoAnswer, ServoQuestion, ServoStatus
from protocol.errors import MessageError
from protocol.publication import Publication
from robot.arm import Arm
from robot.description.model import RobotModel
from server.errors import RefusedError
from server.execution.current_state import check_ready
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.state import SceneState
from server.moveit.servo.commands import Message, Resolve, Wanted, read_joint_jog, read_pose_target, read_twist
from server.moveit.servo.gate import CommandType, Gate
from server.moveit.servo.session import ServoSession, Steered
from server.moveit.servo.status import StatusTopic, log

TWIST_TOPIC = "/servo_node/delta_twist_cmds"
JOINT_TOPIC = "/servo_node/delta_joint_cmds"
POSE_TOPIC = "/servo_node/pose_target_cmds"

SWITCH_SERVICE = "/servo_node/switch_command_type"
PAUSE_SERVICE = "/servo_node/pause_servo"
START_SERVICE = "/servo_node/start_servo"
STOP_SERVICE = "/servo_node/stop_servo"
UNPAUSE_SERVICE = "/servo_node/unpause_servo"
RESET_SERVICE = "/servo_node/reset_servo_status"

_TYPES = {
    CommandType.TWIST: (TWIST_TOPIC, "geometry_msgs/TwistStamped"),
    CommandType.JOINT_JOG: (JOINT_TOPIC, "control_msgs/JointJog"),
    CommandType.POSE: (POSE_TOPIC, "geometry_msgs/PoseStamped"),
}


class ServoNode:
    """Lets clients steer the arm.

    Args:
        graph: where the topics and services are.
        robot: the arm.
        parameters: group, tip, and how the arm is steered.
        scene: what is in the way.
        resolve: finds frames.
    """

    def __init__(
        self, graph: Graph, robot: RobotModel, parameters: MoveItParameters, scene: SceneState, resolve: Resolve
    ) -> None:
        self._graph = graph
        self._group = robot.groups[parameters.group_name]
        self._link = parameters.end_effector_link or self._group.tip_link
        self._parameters = parameters.servo
        self._scene = scene
        self._resolve = resolve
        self._node = Node("servo_node")
        self._status = StatusTopic(graph, self._node, self._parameters.status_type)
        self._turned_away = ""
        self._session: ServoSession | None = None

    def open(self, arm: Arm, pool: PlannerPool, busy: Callable[[], str]) -> None:
        """Begin to take commands.

        Args:
            arm: what is steered.
            pool: the planners.
            busy: who moves the arm otherwise, or an empty text.
        """
        parameters = self._parameters
        timeout_s = parameters.incoming_command_timeout

        def closed() -> str:
            try:
                check_ready(arm)
            except RefusedError as error:
                return str(error)
            return busy()

        gate = Gate(self._present, timeout_s, closed)
        group = self._group
        steered = Steered(group.name, group.joints, self._link, parameters.limits, 1.0 / parameters.rate_hz, timeout_s)

        def ask(question: ServoQuestion) -> Coroutine[Any, Any, ServoAnswer | PlanningFailure]:
            return pool.ask(question, self._scene.scene)

        session = ServoSession(arm, steered, ask, self._resolve, self._status.tell, gate.interrupt)
        self._session = session
        self._status.open()
        for kind in CommandType:
            self._listen(kind, gate, session)
        self._offer(gate, session)

    async def close(self) -> None:
        """Let go of the arm."""
        if self._session is not None:
            await self._session.close()

    def _listen(self, kind: CommandType, gate: Gate, session: ServoSession) -> None:
        topic, type_name = _TYPES[kind]

        def deliver(publication: Publication) -> None:
            refusal = gate.refusal(publication.publisher, kind, time.monotonic())
            if refusal is None:
                self._follow(kind, publication.msg, session)
            elif refusal.of_owner:
                self._status.tell(ServoStatus.INVALID, refusal.message)
            elif refusal.message != self._turned_away:
                self._turned_away = refusal.message
                log.warning("servo: %s", refusal.message)

        def refused(error: MessageError) -> None:
            log.warning("%s: %s", topic, error)

        self._graph.subscribe(self._node, topic, type_name, Subscriber(deliver, refused))

    def _follow(self, kind: CommandType, message: Message, session: ServoSession) -> None:
        wanted = self._read(kind, message, session)
        if isinstance(wanted, PlanningFailure):
            self._status.tell(ServoStatus.INVALID, wanted.message)
        else:
            session.want(wanted)

    def _read(self, kind: CommandType, message: Message, session: ServoSession) -> Wanted | PlanningFailure:
        match kind:
            case CommandType.TWIST:
                return read_twist(message, self._parameters)
            case CommandType.JOINT_JOG:
                return read_joint_jog(message, self._group.joints, self._parameters)
            case CommandType.POSE:
                return read_pose_target(message, self._resolve, session.positions_rad())

    def _offer(self, gate: Gate, session: ServoSession) -> None:
        def switch(request: Message) -> dict[str, Any]:
            known = request["command_type"] in set(CommandType)
            if known:
                gate.select(CommandType(request["command_type"]))
            return {"success": known}

        def pause(*, paused: bool) -> dict[str, Any]:
            gate.paused = paused
            gate.reset()
            if paused:
                session.release()
            return {"success": True, "message": "servo is paused" if paused else "servo takes commands"}

        def reset(_request: Message) -> dict[str, Any]:
            gate.reset()
            return {}

        offer = self._graph.services.offer
        offer(self._node, SWITCH_SERVICE, "moveit_msgs/ServoCommandType", switch)
        offer(self._node, PAUSE_SERVICE, "std_srvs/SetBool", lambda request: pause(paused=request["data"]))
        offer(self._node, STOP_SERVICE, "std_srvs/Trigger", lambda _request: pause(paused=True))
        for name in (START_SERVICE, UNPAUSE_SERVICE):
            offer(self._node, name, "std_srvs/Trigger", lambda _request: pause(paused=False))
        offer(self._node, RESET_SERVICE, "std_srvs/Empty", reset)

    def _present(self, client: object) -> bool:
        return any(client in self._graph.publishers(topic) for topic, _ in _TYPES.values())
