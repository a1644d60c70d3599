"""The arm on the graph: the topics of its state, and the services and topics of orders to it."""

import asyncio
import functools
import logging
from collections.abc import Awaitable, Callable
from typing import Any

from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from robot.arm_group import AnyArm, moves, states_of
from robot.calibration import Calibration
from robot.description.model import RobotModel
from robot.faults import Fault
from robot.messages import (
    MIN_SPEED_LIMIT,
    ArmHealth,
    ArmState,
    ChangePace,
    CommandDone,
    Mode,
    Order,
    Pace,
    PlaybackDirection,
)
from robot.stop_epochs import STOP_EPOCHS
from server.arrival import arrival_epoch
from server.diagnostic_values import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, diagnostic_status, key_values
from server.errors import ServiceError
from server.execution.monitors import ENABLE, RESET_FAULT
from server.graph.permissions import STOPPING, SWITCHING, WORKING, Rule
from server.graph.topics import Graph, LocalGraph
from server.moveit.requests.planning_context import GoalContext

log = logging.getLogger("armbridge.arm")

TOPIC = "/joint_states"

# Topics that are published with every state, or with every other: it, also of one of several arms, /tf, and
# controllers' states.
_FREQUENT = (TOPIC, "/tf", "_controller/controller_state", "_controller/state")


def states_are_observed(graph: Graph) -> bool:
    """Return True while somebody subscribes to a topic that is published with the arm's states."""
    return any(graph.subscribers(topic) for topic in graph.topic_names.types() if topic.endswith(_FREQUENT))


STATE_TOPIC = "/arm/state"
LIMITS_TOPIC = "/arm/joint_limits"

_SENTENCES = {
    Mode.DISCONNECTED: "the arm is not connected",
    Mode.CONNECTED: "the servos are being checked",
    Mode.RELAXED: "the arm is relaxed; {prefix}" + ENABLE + " makes it hold",
    Mode.HOLDING: "the arm holds",
    Mode.MOVING: "the arm moves",
    Mode.FAULT: "the arm has a fault",
}
# Start of the keys with the calibrated range of each joint, "LOWER UPPER" [rad].
CALIBRATED_RANGE = "calibrated_range_rad."

_LEVELS = {Mode.DISCONNECTED: LEVEL_ERROR, Mode.CONNECTED: LEVEL_WARN, Mode.FAULT: LEVEL_ERROR}


class ArmStateTopics:
    """Publishes the arm's mode, fault and pace, its calibrated ranges without margin, its joints and their limits."""

    def __init__(self, graph: LocalGraph, robot: RobotModel, state: ArmState, calibration: Calibration | None) -> None:
        self._ranges = {
            f"{CALIBRATED_RANGE}{each.joint}": f"{each.lower_rad:.5f} {each.upper_rad:.5f}"
            for each in (calibration.joints if calibration else ())
        }
        self._robot = robot
        self._node, self._joints = graph.node("arm state"), graph.node("arm")
        # Contents of the last message.
        self._shown: tuple[Mode, str, Fault | None, Pace, int, int] | None = None
        self._limits: dict[str, Any] | None = None
        self._joints.advertise(TOPIC, "sensor_msgs/JointState")
        self._node.advertise(STATE_TOPIC, "diagnostic_msgs/DiagnosticStatus", latch=True)
        self._node.advertise(LIMITS_TOPIC, "moveit_msgs/KinematicSolverInfo", latch=True)
        self._publish_limits({joint.name: (joint.lower, joint.upper) for joint in robot.movable_joints})
        self.take_state(state)

    def take_state(self, state: ArmState, last_stop: int = 0) -> None:
        """Publish a state when it has news, such as a stop of this arm or, for requests that name it, of any part."""
        stops = STOP_EPOCHS.present
        shown = state.mode, state.reason, state.fault, state.pace, last_stop, stops
        if shown != self._shown:
            self._shown = shown
            message = status(state, self._robot.name, self._node.resolve(""))
            message["values"] += key_values({"last_stop": str(last_stop), "stops": str(stops)} | self._ranges)
            self._node.publish(STATE_TOPIC, message)

    def publish_joints(self, state: ArmState) -> None:
        """Publish the joints of a state; a disconnected arm has none.

        Effort is the share of full motor duty, -1..1: the servos measure no torque.
        """
        if state.position_rad is None or state.velocity_rad_s is None or state.load is None:
            return
        message: dict[str, Any] = {
            "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
            "name": list(state.joint_names),
            "position": state.position_rad.tolist(),
            "velocity": state.velocity_rad_s.tolist(),
            "effort": state.load.tolist(),
        }
        self._joints.publish(TOPIC, message)

    def take_health(self, health: ArmHealth) -> None:
        """Publish the limits that the arm process keeps, when they are others."""
        if health.limits_rad is not None:
            names = [joint.joint for joint in health.joints]
            self._publish_limits(
                {name: (low, high) for name, (low, high) in zip(names, health.limits_rad.tolist(), strict=True)}
            )

    def _publish_limits(self, ranges_rad: dict[str, tuple[float, float]]) -> None:
        message = {
            "joint_names": list(ranges_rad),
            "limits": [
                {
                    "joint_name": name,
                    "has_position_limits": True,
                    "min_position": lower,
                    "max_position": upper,
                    "has_velocity_limits": True,
                    "max_velocity": self._robot.joints[name].max_velocity,
                    "has_acceleration_limits": True,
                    "max_acceleration": self._robot.joints[name].max_acceleration,
                }
                for name, (lower, upper) in ranges_rad.items()
            ],
        }
        if message != self._limits:
            self._limits = message
            self._node.publish(LIMITS_TOPIC, message)


def status(state: ArmState, robot_name: str, prefix: str = "") -> dict[str, Any]:
    """The diagnostic_msgs/DiagnosticStatus of a state; figures that change all the time are not in it."""
    message = _SENTENCES[state.mode].format(prefix=prefix)
    if state.fault is not None:
        message = f"{state.fault} The service that resets it is {prefix}{RESET_FAULT}."
    elif state.reason:
        message = f"{message}: {state.reason}"
    values = {
        "mode": state.mode.value,
        "reason": state.reason,
        "task": state.task,
        "course": state.pace.direction.value,
        "speed_factor": f"{state.pace.speed_factor:g}",
        "speed_limit": f"{state.pace.speed_limit:g}",
    }
    if state.fault is not None:
        values |= {
            "fault": state.fault.code.value,
            "fault_message": state.fault.message,
            "fault_remedy": state.fault.remedy,
            "fault_joint": state.fault.joint,
            "fault_stamp": f"{state.fault.stamp_s:.3f}",
        }
    return diagnostic_status(_LEVELS.get(state.mode, LEVEL_OK), "arm", message, values, robot_name)


RELAX = "/arm/relax"
STOP = "/arm/stop"
EMERGENCY_STOP = "/arm/emergency_stop"
EMERGENCY_STOP_TOPIC = "/emergency_stop"

# Braking takes a second at most.
STOP_TIMEOUT_S = 2.0

# The timeout is by the arm's clock, which a paused simulation stops: interval of looks at that [s].
PAUSE_LOOK_S = 0.1


def offer_arm_services(context: GoalContext) -> None:
    """Offer the services that switch and stop the arm, and listen to ``/emergency_stop``.

    Orders leave for the arm process before anything else happens: no queue, no task and no waiting in between.
    """
    node, arm = context.graph.node("arm services"), context.arm

    def emergency_stop(name: str) -> asyncio.Future[CommandDone]:
        answered = arm.order(Order.EMERGENCY_STOP)
        log.warning("emergency stop by %s", node.resolve(name))
        context.stop(f"emergency stop by {node.resolve(name)}")
        return answered

    def relax() -> Awaitable[CommandDone]:
        context.stop(f"relaxed by {node.resolve(RELAX)}")
        return arm.order(Order.RELAX)

    def stop() -> Awaitable[CommandDone]:
        context.stop(f"stopped by {node.resolve(STOP)}")
        return _standstill(arm)

    def offer(name: str, rule: Rule, act: Callable[[], Awaitable[CommandDone]]) -> None:
        node.offer(name, "std_srvs/Trigger", lambda _request: sentence_of(act()), rule=rule)

    offer(ENABLE, SWITCHING, lambda: arm.order(Order.ENABLE, epoch=arrival_epoch()))
    offer(RELAX, SWITCHING, relax)
    offer(STOP, STOPPING, stop)
    offer(EMERGENCY_STOP, STOPPING, lambda: emergency_stop(EMERGENCY_STOP))
    offer(RESET_FAULT, SWITCHING, lambda: arm.order(Order.RESET_FAULT, epoch=arrival_epoch()))

    def on_emergency_stop(_message: object) -> None:
        emergency_stop(EMERGENCY_STOP_TOPIC).add_done_callback(_log_end)

    node.subscribe(EMERGENCY_STOP_TOPIC, "std_msgs/Empty", on_emergency_stop, rule=STOPPING)


async def _standstill(arm: AnyArm) -> CommandDone:
    resting = asyncio.ensure_future(arm.rest(STOP_TIMEOUT_S))
    try:
        while not (await asyncio.wait([resting], timeout=PAUSE_LOOK_S))[0]:
            states = states_of(arm).values()
            moving = any(state.mode is Mode.MOVING and state.stepped_ticks is None for state in states)
            if not moving and any(state.stepped_ticks is not None for state in states):
                text = "the arm does not move: its time stands still, and it brakes when time passes"
                return CommandDone(0, done=True, message=text)
        done = resting.result()
    finally:
        resting.cancel()
    text = "the arm does not move" if done else f"the arm still moves after {STOP_TIMEOUT_S:g} s"
    return CommandDone(0, done=done, message=text)


async def sentence_of(answered: Awaitable[CommandDone]) -> str:
    """Return the sentence of an order that was carried out; raise ServiceError with the sentence of another."""
    done = await answered
    if not done.done:
        raise ServiceError(done.message)
    return done.message


def _log_end(answered: asyncio.Future[CommandDone]) -> None:
    if not answered.cancelled():
        done = answered.result()
        log.log(logging.WARNING if done.done else logging.ERROR, "emergency stop: %s", done.message)


SPEED_FACTOR_TOPIC = "/arm/speed_factor"
SPEED_LIMIT, SPEED_LIMIT_TYPE = "/arm/set_speed_limit", "armbridge_msgs/srv/SetSpeedLimit"
PAUSE = "/arm/pause"
RESUME = "/arm/resume"
STEP_BACK = "/arm/step_back"

_PACE_SENTENCES = {
    PlaybackDirection.PAUSED: f"the arm comes to rest on its path; {{prefix}}{RESUME} lets it go on",
    PlaybackDirection.FORWARD: "the arm goes on",
    PlaybackDirection.BACK: f"the arm goes back along its path until {{prefix}}{PAUSE} or {{prefix}}{RESUME}, "
    "at most to where it came from",
}


def offer_pace(graph: LocalGraph, arm: AnyArm) -> None:
    """Offer the pace of motions: speed, pause and the way back, and the speed limit.

    The speed factor is the driver's: a share of the planned speed of every motion, also of a slow one. The speed limit
    is the operator's: a share of the joints' velocity limits, which slows down only faster motions, of every client and
    of the gripper. Guards and limits of the arm hold at every pace.
    """
    node = graph.node("arm pace")

    def set_speed(published: PublishedMessage) -> None:
        factor = published.msg["data"]
        if 0.0 <= factor <= 1.0:
            arm.change_pace(ChangePace(speed_factor=factor))
        else:
            log.warning("%s: data must be 0 to 1, a share of the planned speed, not %s", SPEED_FACTOR_TOPIC, factor)

    def set_limit(request: dict[str, Any]) -> str:
        limit = request["speed_limit"]
        if not MIN_SPEED_LIMIT <= limit <= 1.0:
            raise ServiceError(
                f"speed_limit must be {MIN_SPEED_LIMIT:g} to 1, a share of the joints' velocity limits, not {limit:g};"
                f" {node.resolve(PAUSE)} and {node.resolve(STOP)} bring the arm to rest"
            )
        log.info("%s: speed limit %g, before %g", node.resolve(SPEED_LIMIT), limit, arm.state.pace.speed_limit)
        arm.change_pace(ChangePace(speed_limit=limit))
        return f"no joint is faster than {limit:.0%} of its velocity limit"

    def offer(name: str, direction: PlaybackDirection, rule: Rule) -> None:
        def change(_request: dict[str, Any]) -> str:
            if not moves(arm):
                raise ServiceError(f"no motion is in progress: the arm is {arm.state.mode.value}")
            arm.change_pace(ChangePace(direction=direction))
            return _PACE_SENTENCES[direction].format(prefix=node.resolve(""))

        node.offer(name, "std_srvs/Trigger", change, rule=rule)

    rejected = functools.partial(log.warning, "%s: %s", SPEED_FACTOR_TOPIC)
    node.subscribe(SPEED_FACTOR_TOPIC, "std_msgs/Float64", set_speed, rejected, rule=SWITCHING)
    # A pause slows the arm down to rest, which harms nobody.
    offer(PAUSE, PlaybackDirection.PAUSED, WORKING)
    offer(RESUME, PlaybackDirection.FORWARD, SWITCHING)
    offer(STEP_BACK, PlaybackDirection.BACK, SWITCHING)
    # It moves nothing: an operator may lower it while another client drives.
    node.offer(SPEED_LIMIT, SPEED_LIMIT_TYPE, set_limit, rule=WORKING)
