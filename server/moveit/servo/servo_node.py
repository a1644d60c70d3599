"""Topics and services of MoveIt Servo: commands, status, and the services of both its generations."""

import functools
import json
import logging
import math
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from planners.servo.question import ServoStatus
from protocol.publication import PublishedMessage
from robot.arm_group import AnyArm
from robot.description.model import RobotModel
from robot.logs import LogLimiter
from robot.stop_epochs import STOP_EPOCHS, STOPPED_SINCE
from server.arrival import arrival_epoch, is_stopped
from server.errors import RefusedError, ServiceError, UnsuccessfulError, invalid
from server.execution.monitors import check_ready
from server.execution.streams import STREAM_PAUSE_S, Silence
from server.graph.permissions import STOPPING, SWITCHING
from server.graph.topics import LocalNode
from server.moveit.messages import Message
from server.moveit.parameters import LEAST_TIMEOUT_S, MoveItParameters
from server.moveit.requests.constraints import planning_group, tip_link
from server.moveit.requests.planning_context import GoalContext
from server.moveit.servo.servo_loop import (
    ServoInput,
    ServoSession,
    ServoSetup,
    read_joint_jog,
    read_pose_target,
    read_twist,
)

log = logging.getLogger("armbridge.servo")

TWIST_TOPIC = "/servo_node/delta_twist_cmds"
JOINT_TOPIC = "/servo_node/delta_joint_cmds"
POSE_TOPIC = "/servo_node/pose_target_cmds"
STATUS_TOPIC = "/servo_node/status"
TIMEOUT_TOPIC = "/servo_node/command_timeout"
PARAMETERS_TOPIC = "/servo_node/parameters"

SWITCH_SERVICE = "/servo_node/switch_command_type"
PAUSE_SERVICE = "/servo_node/pause_servo"
START_SERVICE = "/servo_node/start_servo"
STOP_SERVICE = "/servo_node/stop_servo"
UNPAUSE_SERVICE = "/servo_node/unpause_servo"
RESET_SERVICE = "/servo_node/reset_servo_status"

INT8 = "std_msgs/Int8"

# Parameters that a client needs to send velocities of its choice.
PUBLISHED_PARAMETERS = {
    "command_in_type",
    "linear_scale",
    "rotational_scale",
    "joint_scale",
    "incoming_command_timeout",
}

# moveit_servo/status_codes.h of humble; the other values are the same in both generations.
HUMBLE_NUMBERS = {
    ServoStatus.DECELERATE_FOR_COLLISION: 3,
    ServoStatus.HALT_FOR_COLLISION: 4,
    ServoStatus.JOINT_BOUND: 5,
    ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY: 6,
}

# A client repeats a rejected command many times a second.
LOGGED_AGAIN_S = 5.0

# An epoch before every stop.
BEFORE_EVERY_STOP = -1

# A client in control sends many commands a second.
OWNERSHIP_TIMEOUT_S = 1.0


class CommandType(IntEnum):
    """Values of moveit_msgs/ServoCommandType."""

    JOINT_JOG = 0
    TWIST = 1
    POSE = 2


@dataclass
class Press:
    """Last press of a client that announces its presses."""

    epoch: int  # stop epoch of its arrival
    timeout_s: float  # time after which this client's commands expire [s]
    delay_s: float = math.inf  # of the fastest command since, which contains the difference of both clocks [s]


class StatusPublisher:
    """Publisher of ``/servo_node/status``, after every step of the loop and for every rejected command."""

    def __init__(self, node: LocalNode, type_name: str) -> None:
        self._node = node
        self._type_name = type_name
        self._log = LogLimiter(1, 1.0 / LOGGED_AGAIN_S)
        node.advertise(STATUS_TOPIC, type_name, latch=True)

    def publish(self, status: ServoStatus, message: str) -> None:
        """Publish a status; an error is logged as well, once in `LOGGED_AGAIN_S` while it is repeated."""
        if status is ServoStatus.INVALID:
            self._log.write(log, logging.WARNING, f"servo: {message}", message, self._node.clock())
        if self._type_name == INT8:
            self._node.publish(STATUS_TOPIC, {"data": HUMBLE_NUMBERS.get(status, int(status))})
        else:
            self._node.publish(STATUS_TOPIC, {"code": int(status), "message": message})


class CommandGate:
    """Gate that passes the commands of the client in control; after a stop a stick must be released first."""

    def __init__(self, present: Callable[[object], bool], timeout_s: float, arm: AnyArm) -> None:
        self._present = present
        self.owner: object = None  # the client in control, until it leaves or sends no more commands
        self._timeout_s = timeout_s  # a stick that is silent for this time counts as released
        self._arm = arm
        # Stop epoch of the last command.
        self._heard_epoch = 0
        # Of each client that announces its presses.
        self._presses: dict[object, Press] = {}
        self._silences: dict[object, Silence] = {}  # of each client that sends commands
        self._heard_s = -float("inf")
        self._interrupted = ""
        self.paused = False  # true while all commands are rejected

    def press(self, client: object, timeout_s: float, present: Container[object]) -> None:
        """Take the announcement of a press: from now on, this client announces each press after a release.

        Silence alone is no release then: commands also have a gap where the client's process or network stood still.

        Args:
            timeout_s: time after which this client's commands expire, at most the timeout of all [s].
            present: every client that announces presses and is still connected.
        """
        if not math.isfinite(timeout_s) or timeout_s < LEAST_TIMEOUT_S:
            text = f"{TIMEOUT_TOPIC}: data must be at least {LEAST_TIMEOUT_S:g} s, not {timeout_s:g}"
            raise invalid(text, field="data")
        self._presses = {each: press for each, press in self._presses.items() if each in present}
        self._presses[client] = Press(arrival_epoch(), timeout_s)

    def timeout_s(self, client: object) -> float:
        """Return the time after which a client's commands expire [s]."""
        press = self._presses.get(client)
        return self._timeout_s if press is None else min(press.timeout_s, self._timeout_s)

    def has_expired(self, client: object, stamp: Mapping[str, int], now_s: float) -> bool:
        """Return true for a stamped command that waited while server or network stood still, and may be over."""
        press, sent_s = self._presses.get(client), stamp["sec"] + 1e-9 * stamp["nanosec"]
        if press is None or sent_s == 0.0:
            return False
        press.delay_s = min(press.delay_s, now_s - sent_s)
        return now_s - sent_s > press.delay_s + self.timeout_s(client)

    def interrupt(self, reason: str) -> None:
        """Reject all commands until the stick is released: the arm was stopped from elsewhere."""
        self._interrupted = reason
        for press in self._presses.values():
            press.epoch = BEFORE_EVERY_STOP

    def reset(self) -> None:
        """Accept commands again after an interruption."""
        self._interrupted = ""
        self._heard_epoch = arrival_epoch()
        for press in self._presses.values():
            press.epoch = self._heard_epoch

    def rejection(self, client: object, now_s: float) -> str:
        """Return the reason for not following a command; empty if it is followed."""
        if (silence := self._silences.get(client)) is None:
            self._silences = {each: silence for each, silence in self._silences.items() if self._present(each)}
            silence = self._silences[client] = Silence(self._timeout_s)
        let_go = silence.take_message()
        left = now_s - self._heard_s > OWNERSHIP_TIMEOUT_S or not self._present(self.owner)
        if self.owner is not None and left:
            self.owner = None
        if self.owner not in (None, client):
            return f"{client} cannot steer the arm: {self.owner} does"
        self.owner = client
        self._heard_s = now_s
        stopped, last_stop = is_stopped(self._arm.last_stop), self._arm.last_stop
        press = self._presses.get(client)
        pressed = press is None or not is_stopped(last_stop, press.epoch)
        if let_go and pressed and not stopped:
            self._interrupted = ""
        elif stopped or is_stopped(last_stop, self._heard_epoch):
            self._interrupted = "the arm was stopped"
        self._heard_epoch = arrival_epoch()
        if self.paused:
            return "servo is paused: unpause it by the service /servo_node/pause_servo or start_servo"
        if self._interrupted:
            then = f", then publish {TIMEOUT_TOPIC} again," if client in self._presses else ""
            return f"{self._interrupted}; let go for {self._timeout_s:g} s{then} to steer again"
        return ""


def servo_setup(robot: RobotModel, parameters: MoveItParameters) -> ServoSetup:
    group, servo = planning_group(robot, "", parameters), parameters.servo
    link = tip_link(robot, group, parameters)
    return ServoSetup(group.name, group.joints, link, servo.limits, 1.0 / servo.rate_hz, servo.incoming_command_timeout)


class ServoNode:
    """MoveIt Servo's node; by the names of all arms, the configured group is steered.

    Goals that move the steered arm have precedence, except a policy's.
    """

    def __init__(self, context: GoalContext) -> None:
        planning, servo = context.planning, context.parameters.servo
        setup = servo_setup(planning.robot, context.parameters)
        arm = self._arm = context.arm.part(setup.joints)
        self._queue, self._resolve = context.queue, planning.frames.resolve
        self._busy_joints = frozenset(name for name in context.joints if context.arm.part((name,)) is arm)
        self._node = context.graph.node("servo_node")
        self._status = StatusPublisher(self._node, servo.status_type)
        self._gate = CommandGate(self._present, setup.timeout_s, arm)
        self._session = ServoSession(arm, setup, planning, self._status.publish, self._gate.interrupt)
        self._last_stop = 0  # stop epoch of the last stop of steering alone
        # The last logged rejection: a client without control repeats its commands many times a second.
        self._logged = ""
        for topic, type_name, read in (
            (TWIST_TOPIC, "geometry_msgs/TwistStamped", lambda twist: read_twist(twist, servo)),
            (JOINT_TOPIC, "control_msgs/JointJog", lambda jog: read_joint_jog(jog, setup.joints, servo)),
            (POSE_TOPIC, "geometry_msgs/PoseStamped", self._read_pose),
        ):
            self._subscribe(topic, type_name, functools.partial(self._take_command, read))
        self._subscribe(TIMEOUT_TOPIC, "std_msgs/Float64", self._take_press)
        self._node.advertise(PARAMETERS_TOPIC, "std_msgs/String", latch=True)
        values = servo.model_dump(include=PUBLISHED_PARAMETERS)
        self._node.publish(PARAMETERS_TOPIC, {"data": json.dumps(values)})
        self._offer()

    async def close(self) -> None:
        await self._session.close()

    def _subscribe(self, topic: str, type_name: str, take: Callable[[PublishedMessage], None]) -> None:
        def deliver(published: PublishedMessage) -> None:
            try:
                take(published)
            except RefusedError as error:
                self._status.publish(ServoStatus.INVALID, str(error))

        reject = functools.partial(log.warning, "%s: %s", topic)
        self._node.subscribe(topic, type_name, deliver, reject, rule=SWITCHING)

    def _take_command(self, read: Callable[[Message], ServoInput], published: PublishedMessage) -> None:
        client, now_s = published.publisher, self._node.clock()
        rejection = self._gate.rejection(client, now_s)
        if rejection and self._gate.owner is not client:
            if rejection != self._logged:
                self._logged = rejection
                log.warning("servo: %s", rejection)
        elif rejection:
            raise invalid(rejection)
        else:
            check_ready(self._arm)
            command = read(published.msg)
            if not command.zero:
                if self._gate.has_expired(client, published.msg["header"]["stamp"], now_s):
                    raise invalid("the command has expired on its way")
                held_until_s = now_s + STREAM_PAUSE_S
                hand = f"steering by {client}"
                self._queue.take_over(self._busy_joints, hand, lambda: self._node.clock() < held_until_s)
            if busy := self._queue.busy(self._busy_joints):
                raise invalid(busy)
            self._session.set_command(command, self._gate.timeout_s(client))

    def _take_press(self, published: PublishedMessage) -> None:
        present = self._node.publishers(TIMEOUT_TOPIC)
        self._gate.press(published.publisher, float(published.msg["data"]), present)

    def _read_pose(self, message: Message) -> ServoInput:
        return read_pose_target(message, self._resolve, self._session.positions_rad())

    def _offer(self) -> None:
        gate, session = self._gate, self._session

        def switch(request: Message) -> dict[str, Any]:
            wanted = request["command_type"]
            if wanted not in set(CommandType):
                known = ", ".join(f"{kind.value} ({kind.name})" for kind in CommandType)
                raise UnsuccessfulError({"success": False}, f"command_type must be one of {known}, not {wanted}")
            # The topic of a command says its type.
            return {"success": True}

        def pause(*, paused: bool) -> str:
            if not paused and is_stopped(self._last_stop):
                raise ServiceError(STOPPED_SINCE)
            gate.paused = paused
            gate.reset()
            if paused:
                session.release()
            return "servo is paused" if paused else "servo takes commands"

        def stop(_request: Message) -> str:
            self._last_stop = STOP_EPOCHS.begin()
            return pause(paused=True)

        def reset(_request: Message) -> dict[str, Any]:
            gate.reset()
            return {}

        offer = self._node.offer
        offer(SWITCH_SERVICE, "moveit_msgs/ServoCommandType", switch, rule=SWITCHING)
        offer(PAUSE_SERVICE, "std_srvs/SetBool", lambda request: pause(paused=request["data"]), rule=SWITCHING)
        offer(STOP_SERVICE, "std_srvs/Trigger", stop, rule=STOPPING)
        for name in (START_SERVICE, UNPAUSE_SERVICE):
            offer(name, "std_srvs/Trigger", lambda _request: pause(paused=False), rule=SWITCHING)
        offer(RESET_SERVICE, "std_srvs/Empty", reset, rule=SWITCHING)

    def _present(self, client: object) -> bool:
        return any(client in self._node.publishers(topic) for topic in (TWIST_TOPIC, JOINT_TOPIC, POSE_TOPIC))
