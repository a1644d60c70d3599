"""Orders to the arm: the services under ``/arm/`` and the topics ``/emergency_stop`` and ``/arm/speed_factor``."""

import asyncio
import functools
import logging
from collections.abc import Awaitable, Callable
from typing import Any

from protocol.publication import PublishedMessage
from robot.arm_group import AnyArm, moves, states_of
from robot.messages import MIN_SPEED_LIMIT, ChangePace, CommandDone, Mode, Order, PlaybackDirection
from server.arrival import arrival_epoch
from server.errors import ServiceError
from server.execution.monitors import ENABLE, RESET_FAULT
from server.graph.permissions import STOPPING, SWITCHING, WORKING, Rule
from server.graph.topics import LocalGraph

log = logging.getLogger("armbridge.arm")

RELAX = "/arm/relax"
STOP = "/arm/stop"
EMERGENCY_STOP = "/arm/emergency_stop"
EMERGENCY_STOP_TOPIC = "/emergency_stop"

# Braking takes a second at most.
STOP_TIMEOUT_S = 2.0

# The timeout is by the arm's clock, which a paused simulation stops: interval of looks at that [s].
PAUSE_LOOK_S = 0.1

ServiceFields = dict[str, Any]


def offer_arm_services(graph: LocalGraph, arm: AnyArm, end_goals: Callable[[str], None]) -> None:
    """Offer the services that switch and stop the arm, and listen to ``/emergency_stop``.

    Orders leave for the arm process before anything else happens: no queue, no task and no waiting in between.
    """
    node = graph.node("arm services")

    def emergency_stop(name: str) -> asyncio.Future[CommandDone]:
        answered = arm.order(Order.EMERGENCY_STOP)
        log.warning("emergency stop by %s", node.resolve(name))
        end_goals(f"emergency stop by {node.resolve(name)}")
        return answered

    def relax() -> Awaitable[CommandDone]:
        end_goals(f"relaxed by {node.resolve(RELAX)}")
        return arm.order(Order.RELAX)

    def stop() -> Awaitable[CommandDone]:
        end_goals(f"stopped by {node.resolve(STOP)}")
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

_SENTENCES = {
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

    def set_limit(request: ServiceFields) -> str:
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
        def change(_request: ServiceFields) -> str:
            if not moves(arm):
                raise ServiceError(f"no motion is in progress: the arm is {arm.state.mode.value}")
            arm.change_pace(ChangePace(direction=direction))
            return _SENTENCES[direction].format(prefix=node.resolve(""))

        node.offer(name, "std_srvs/Trigger", change, rule=rule)

    rejected = functools.partial(log.warning, "%s: %s", SPEED_FACTOR_TOPIC)
    node.subscribe(SPEED_FACTOR_TOPIC, "std_msgs/Float64", set_speed, rejected, rule=SWITCHING)
    # A pause slows the arm down to rest, which harms nobody.
    offer(PAUSE, PlaybackDirection.PAUSED, WORKING)
    offer(RESUME, PlaybackDirection.FORWARD, SWITCHING)
    offer(STEP_BACK, PlaybackDirection.BACK, SWITCHING)
    # It moves nothing: an operator may lower it while another client drives.
    node.offer(SPEED_LIMIT, SPEED_LIMIT_TYPE, set_limit, rule=WORKING)
