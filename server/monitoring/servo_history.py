"""History of each servo over the last ten minutes: the service ``/arm/servo_history``.

Samples come with the arm's health, about once a second; events are faults, lost connections, errors that were counted,
and warnings that came and went.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from robot.faults import ServoAlert
from robot.messages import ArmHealth, ArmState, Mode
from server.graph.permissions import LOOKING
from server.graph.topics import Graph

SERVICE = "/arm/servo_history"
SERVICE_TYPE = "armbridge_msgs/srv/GetServoHistory"

WINDOW_S = 600.0

# A report a second; a simulated arm that runs slower than real time sends fewer.
MAX_SAMPLES = 600

# A loose plug makes events all the time: of all joints together, the latest.
MAX_EVENTS = 300

# Fields of a sample besides its time, in the order of the columns.
QUANTITIES = ("temperature_c", "load", "voltage_v", "current_a")


class Event(NamedTuple):
    """Event in the history; ``joint`` is empty for one of the whole arm, ``at_s`` is monotonic [s]."""

    at_s: float
    joint: str
    sentence: str


class ServoHistory:
    """History of an arm's servos."""

    def __init__(self, graph: Graph) -> None:
        self._clock = graph.clock
        # Time and quantities of each sample, by joint.
        self._samples: dict[str, deque[tuple[float, ...]]] = {}
        self._events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._state: ArmState | None = None
        # Warnings of each joint by alert and register, and its errors.
        self._warnings: dict[str, Mapping[tuple[ServoAlert, str], str]] = {}
        self._errors: dict[str, Mapping[str, int]] = {}
        graph.node("servo history").offer(SERVICE, SERVICE_TYPE, self._serve, rule=LOOKING)

    def take_state(self, state: ArmState) -> None:
        before, self._state = self._state, state
        if before is None:
            return
        if state.fault is not None and (before.fault is None or state.fault.code is not before.fault.code):
            self._add(state.fault.joint, f"fault {state.fault.code.value}: {state.fault.message}")
        elif before.fault is not None and state.fault is None:
            self._add(before.fault.joint, f"fault {before.fault.code.value} was reset")
        lost, was_lost = state.mode is Mode.DISCONNECTED, before.mode is Mode.DISCONNECTED
        if lost and not was_lost:
            self._add("", f"disconnected: {state.reason}")
        elif was_lost and not lost:
            self._add("", "connected")

    def take_health(self, health: ArmHealth) -> None:
        now_s = self._clock()
        for joint in health.joints:
            samples = self._samples.setdefault(joint.joint, deque(maxlen=MAX_SAMPLES))
            samples.append((now_s, *(getattr(joint, quantity) for quantity in QUANTITIES)))
            warnings = {(each.alert, each.register): each.sentence for each in joint.warnings}
            before = self._warnings.get(joint.joint, {})
            for kind in warnings.keys() - before.keys():
                self._add(joint.joint, f"warning: {warnings[kind]}")
            for kind in before.keys() - warnings.keys():
                self._add(joint.joint, f"no longer: {before[kind]}")
            self._warnings[joint.joint] = warnings
            counted = self._errors.get(joint.joint, {})
            for error, count in joint.errors.items():
                # Opened again, the hardware counts from zero.
                if count > counted.get(error, 0):
                    self._add(joint.joint, f"error {error}, {count} since the servo was connected")
            self._errors[joint.joint] = joint.errors

    def _add(self, joint: str, sentence: str) -> None:
        self._events.append(Event(self._clock(), joint, sentence))

    def _serve(self, request: dict[str, Any]) -> dict[str, Any]:
        joint = request["joint"]
        if joint not in self._samples:
            known = f"joint: must be one of {', '.join(self._samples)}, not {joint[:80]!r}"
            return {"message": known if self._samples else "the arm has not reported on its servos yet"}
        now_s = self._clock()
        samples = [each for each in self._samples[joint] if each[0] >= now_s - WINDOW_S]
        at_s, *values = np.array(samples).reshape(len(samples), 1 + len(QUANTITIES)).T
        columns = {
            # An ideal arm measures nothing of this kind.
            quantity: [] if np.isnan(column).all() else column.round(4).tolist()
            for quantity, column in zip(QUANTITIES, values, strict=True)
        }
        events = [
            f"{now_s - event.at_s:.0f} s ago: {event.sentence}"
            for event in self._events
            if event.joint in ("", joint) and now_s - event.at_s <= WINDOW_S
        ]
        return {**columns, "time_s": (at_s - now_s).round(3).tolist(), "events": events, "success": True}
