"""Whether the server is alive and whether it can carry out goals, with the reasons when not."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus

from robot.messages import Mode
from server.gateway.http import Answer
from server.operations.parts import ArmPart, Parts, PlannersPart

# While there is no bus, the arm process is heard at each attempt to open it: every 2 s, and opening takes its time.
ARM_SILENT_S = 10.0

# A state is sent at least once a second while the arm is connected; a simulated arm may be starved for longer.
ARM_STALE_S = 1.5


@dataclass(frozen=True)
class Health:
    """What is told to who watches over the server.

    Everybody may ask, so sentences name no device, file, address or client: those are on ``/arm/state``.

    Attributes:
        live: whether it does what it can; otherwise to start it anew is the only remedy.
        ready: whether a goal would be carried out now, as far as that depends on the server.
        reasons: why it is not live or not ready, a sentence each.
        warnings: what else is wrong, a sentence each.
    """

    live: bool
    ready: bool
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def answer(self, *, good: bool) -> Answer:
        """The answer over HTTP: 200 when what was asked for is good, else 503."""
        status = HTTPStatus.OK if good else HTTPStatus.SERVICE_UNAVAILABLE
        return Answer.of_data(status, json.dumps(dataclasses.asdict(self)).encode() + b"\n", "application/json")


def health_of(parts: Parts) -> Health:
    """Look at all parts."""
    silent = tuple(_why_not_live(parts.arm)) if parts.started and not parts.stopping else ()
    reasons = silent or tuple(_why_not_ready(parts))
    return Health(not silent, not reasons, reasons, tuple(_warnings(parts)))


def _why_not_live(arm: ArmPart | None) -> Iterator[str]:
    if arm is not None and arm.state_age_s > ARM_SILENT_S:
        yield f"the arm process has been silent for more than {ARM_SILENT_S:g} s"


def _why_not_ready(parts: Parts) -> Iterator[str]:
    if parts.stopping:
        yield "the server is stopping"
        return
    if not parts.started:
        yield "the server is starting"
    if parts.arm is not None:
        yield from _why_arm_is_not_ready(parts.arm)
    if parts.planners is not None:
        yield from _why_planners_are_not_ready(parts.planners)


def _why_arm_is_not_ready(arm: ArmPart) -> Iterator[str]:
    state = arm.state
    if state.fault is not None:
        yield f"the arm has a fault: {state.fault.code.value}"
    if state.mode is Mode.DISCONNECTED:
        yield "the arm is not connected"
    elif state.mode is Mode.CONNECTED:
        yield "the servos are being checked, or were refused"
    elif arm.state_age_s > (stale_s := max(ARM_STALE_S, arm.state_max_age_s)):
        yield f"the last state of the arm is older than {stale_s:g} s"


def _why_planners_are_not_ready(planners: PlannersPart) -> Iterator[str]:
    if planners.load_failure is not None:
        yield "the planners cannot be started"
    elif planners.loaded_count == 0:
        yield "the planners are loading"


def _warnings(parts: Parts) -> Iterator[str]:
    if parts.arm is not None and parts.arm.state.mode is Mode.RELAXED:
        yield "the arm is relaxed, and has to be enabled before it moves"
    if parts.recorder is not None and parts.recorder.ended and not parts.stopping:
        yield "the recording has ended; the log tells why"
    if parts.recorder is not None and parts.recorder.dropped:
        yield "messages are missing in the recording"
