"""MoveIt Servo's topics and services"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from planners.pool import PlannerPool
from planners.problem import PlanningFailure
from planners.servo.question import ServoAnswer, ServoQuestion, ServoStatus
from protocol.errors import MessageError
from protocol.publication import Publication
from robot.arm import Arm
from robot.model import RobotModel
from server.graph import Graph, Subscriber
from server.moveit.parameters import MoveItParameters
from server.moveit.readiness import unusable
from server.moveit.scene.scene_state import SceneState
from server.moveit.servo.servo_loop import (
    Message,
    Resolve,
    ServoSession,
    Steered,
    Wanted,
    read_joint_jog,
    read_pose_target,
    read_twist,
)
from server.node import Node

log = logging.getLogger("armbridge.servo")

# A client goes on asking for what it was refused.
LOGGED_AGAIN_S = 5.0

STATUS_TOPIC = "/servo_node/status"

INT8 = "std_msgs/Int8"

# moveit_servo/status_codes.h of humble; the others have the same numbers.
HUMBLE_NUMBERS = {
    ServoStatus.DECELERATE_FOR_COLLISION: 3,
    ServoStatus.HALT_FOR_COLLISION: 4,
    ServoStatus.JOINT_BOUND: 5,
    ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY: 6,
}


class StatusTopic:
    """Publishes the status: every step of the steering, and every refusal.

    Args:
        graph: where the topic is.
        node: who publishes.
        type_name: ``moveit_msgs/ServoStatus`` or ``std_msgs/Int8``.
        clock: monotonic time [s].
    """

    def __init__(self, graph: Graph, node: Node, type_name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._graph = graph
        self._node = node
        self._type_name = type_name
        self._clock = clock
        self._logged, self._logged_at_s = "", 0.0

    def open(self) -> None:
        """Advertise."""
        self._graph.advertise(self._node, STATUS_TOPIC, self._type_name, latch=True)

    def tell(self, status: ServoStatus, message: str) -> None:
        """Publish; what was refused is logged as well, but not a hundred times a second."""
        if status is ServoStatus.INVALID:
            self._log(message)
        if self._type_name == INT8:
            told: dict[str, object] = {"data": HUMBLE_NUMBERS.get(status, int(status))}
        else:
            told = {"code": int(status), "message": message}
        self._graph.publish(self._node, STATUS_TOPIC, told)

    def _log(self, message: str) -> None:
        now_s = self._clock()
        if message != self._logged or now_s - self._logged_at_s > LOGGED_AGAIN_S:
            self._logged, self._logged_at_s = message, now_s
            log.warning("servo: %s", message)


# A client that steers says so many times a second.
SILENCE_S = 1.0


class Ownership:
    """Who has the stick.

    Args:
        present: whether a client is still there.
    """

    def __init__(self, present: Callable[[object], bool]) -> None:
        self._present = present
        self._owner: object = None
        self._heard_s = 0.0

    def owner(self, now_s: float) -> object:
        """Who has it; None when nobody has.

        Args:
            now_s: monotonic time [s].
        """
        if self._owner is not None and (now_s - self._heard_s > SILENCE_S or not self._present(self._owner)):
            self._owner = None
        return self._owner

    def take(self, client: object, now_s: float) -> bool:
        """Take or keep the stick; returns whether it is the client's now."""
        owner = self.owner(now_s)
        if owner is not None and owner is not client:
            return False
        self._owner, self._heard_s = client, now_s
        return True


class CommandType(IntEnum):
    """Values of moveit_msgs/ServoCommandType."""

    JOINT_JOG = 0
    TWIST = 1
    POSE = 2


@dataclass(frozen=True)
class Refusal:
    """Why a command is not followed; ``of_owner`` tells whether by who steers, whom the status is for."""

    message: str
    of_owner: bool = True


class Gate:
    """Lets commands through.

    Args:
        present: whether a client is still there.
        timeout_s: a stick counts as let go of after a silence of this time [s].
        busy: why the arm cannot be steered now, or an empty text.

    Attributes:
        paused: whether no command is let through.
    """

    def __init__(self, present: Callable[[object], bool], timeout_s: float, busy: Callable[[], str]) -> None:
        self._ownership = Ownership(present)
        self._timeout_s = timeout_s
        self._busy = busy
        self._selected: CommandType | None = None
        self._heard_s = -float("inf")
        self._interrupted = ""
        self.paused = False

    def select(self, kind: CommandType) -> None:
        """Let through only commands of a kind, until who steers lets go."""
        self._selected = kind

    def interrupt(self, reason: str) -> None:
        """Let nothing through until the stick was let go of: somebody else has stopped the arm."""
        self._interrupted = reason

    def reset(self) -> None:
        """Forget that there was an interruption."""
        self._interrupted = ""

    def refusal(self, client: object, kind: CommandType, now_s: float) -> Refusal | None:
        """Why a command may not steer the arm; None when it may.

        Args:
            client: who sends it.
            kind: of the command.
            now_s: monotonic time [s].
        """
        owner = self._ownership.owner(now_s)
        if owner is None and self._heard_s > -float("inf"):
            # What the last one had selected does not bind the next.
            self._selected, self._heard_s = None, -float("inf")
        if not self._ownership.take(client, now_s):
            return Refusal(f"{client} cannot steer the arm: {owner} does", of_owner=False)
        silence_s, self._heard_s = now_s - self._heard_s, now_s
        if silence_s > self._timeout_s:
            self._interrupted = ""
        message = self._closed(kind)
        return Refusal(message) if message else None

    def _closed(self, kind: CommandType) -> str:
        if self.paused:
            return "servo is paused: unpause it by the service /servo_node/pause_servo or start_servo"
        if self._selected is not None and kind is not self._selected:
            return f"the command type {self._selected.name} was selected; this is a {kind.name} command"
        if self._interrupted:
            return f"{self._interrupted}; let go for {self._timeout_s:g} s to steer again"
        return self._busy()


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
            failure = unusable(arm)
            return busy() if failure is None else failure.message

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
