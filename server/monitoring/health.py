"""Health of the server, from the sources that its parts are: liveness and readiness, with the reasons."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING

from robot.messages import ArmHealth, Mode
from server.gateway.connection import Traffic
from server.gateway.http import HttpResponse

if TYPE_CHECKING:
    from planners.interface import Planners
    from robot.arm_group import AnyArm
    from server.execution.queue import GoalQueue
    from server.monitoring.monitor import GoalCounters
    from server.recording.recorder import Recorder
    from server.zenoh.bridge import Bridge

# Without a bus, the arm process sends a state at each attempt to open it: every 2 s, plus the attempt's own time.
ARM_SILENT_S = 10.0

# A state comes at least once a second while the arm is connected; a simulated arm may be starved for longer.
ARM_STALE_S = 1.5


@dataclass
class Sources:
    """Parts of the server that are monitored; None for those that a server does not have."""

    traffic: Traffic | None = None
    goal_counters: GoalCounters | None = None
    queue: GoalQueue | None = None
    arm: AnyArm | None = None
    arm_health: ArmHealth | None = None
    planners: Planners | None = None
    recorder: Recorder | None = None
    zenoh: Bridge | None = None
    started: bool = False
    stopping: bool = False


@dataclass(frozen=True)
class Health:
    """Health of the server: live unless only a restart can help, ready if a goal would be carried out now.

    Everybody may request it, so its sentences name no device, file, address or client: those are on ``/arm/state``.
    """

    live: bool
    ready: bool
    reasons: tuple[str, ...] = ()

    def response(self, *, good: bool) -> HttpResponse:
        status = HTTPStatus.OK if good else HTTPStatus.SERVICE_UNAVAILABLE
        return HttpResponse.of_json(status, dataclasses.asdict(self))


def check_health(sources: Sources) -> Health:
    silent = sources.arm is not None and sources.arm.state_age_s > ARM_SILENT_S
    is_dead = silent and sources.started and not sources.stopping
    dead = (f"the arm process has been silent for more than {ARM_SILENT_S:g} s",) if is_dead else ()
    reasons = dead or tuple(_reasons_not_ready(sources))
    return Health(not dead, not reasons, reasons)


def _reasons_not_ready(sources: Sources) -> Iterator[str]:
    if sources.stopping:
        yield "the server is stopping"
        return
    if not sources.started:
        yield "the server is starting"
    if sources.arm is not None:
        state = sources.arm.state
        if state.fault is not None:
            yield f"the arm has a fault: {state.fault.code.value}"
        if state.mode is Mode.DISCONNECTED:
            yield "the arm is not connected"
        elif state.mode is Mode.CONNECTED:
            yield "the servos are being checked, or were refused"
        elif sources.arm.state_age_s > (stale_s := max(ARM_STALE_S, sources.arm.state_max_age_s)):
            yield f"the last state of the arm is older than {stale_s:g} s"
    if sources.planners is not None:
        if sources.planners.load_failure is not None:
            yield "the planners cannot be started"
        elif sources.planners.loaded_count == 0:
            yield "the planners are loading"
