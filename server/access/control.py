"""Control of the arm in the graph: the latched topic ``/arm/control``, and the services that take and release it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from server.access.lease import RELEASE_SERVICE, Lease
from server.arm.topics import LEVEL_OK, key_values
from server.graph.node import Node
from server.graph.services import Call, answer
from server.graph.topics import Graph
from server.timers import CallLater, Timer

TOPIC = "/arm/control"
TAKE_SERVICE = "/arm/take_control"

# Tells a client apart from the others on the topic.
WHO_SERVICE = "/arm/who_am_i"

# How often it is looked whether the holder idles, and told for how long it has.
BEAT_S = 1.0


class Control:
    """Tells who drives the arm, and lets clients ask for it.

    Args:
        graph: where topic and services are.
        lease: who drives.
        clock: monotonic time [s].
        call_later: does something after a delay.
    """

    def __init__(self, graph: Graph, lease: Lease, clock: Callable[[], float], call_later: CallLater) -> None:
        self._graph = graph
        self._lease = lease
        self._clock = clock
        self._call_later = call_later
        self._node = Node("arm control")
        self._timer: Timer | None = None

    def open(self, busy: Callable[[], object]) -> None:
        """Advertise and offer.

        Args:
            busy: whether a goal is worked on.
        """
        self._lease.busy = busy
        self._lease.on_change = self._publish
        self._graph.advertise(self._node, TOPIC, "diagnostic_msgs/DiagnosticStatus", latch=True)
        services = {TAKE_SERVICE: self._take, RELEASE_SERVICE: self._release, WHO_SERVICE: self._who}
        for name, serve in services.items():
            self._graph.services.offer_calls(self._node, name, "std_srvs/Trigger", serve)
        self._publish()
        self._beat()

    def close(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()

    def _beat(self) -> None:
        self._lease.tick(self._clock())
        if self._lease.holder is not None:
            self._publish()
        self._timer = self._call_later(BEAT_S, self._beat)

    def _take(self, call: Call) -> None:
        refusal = self._lease.drive(call.caller, self._clock())
        self._answer(call, refusal)

    def _release(self, call: Call) -> None:
        self._answer(call, self._lease.release(call.caller, self._clock()))

    def _who(self, call: Call) -> None:
        caller = call.caller
        role = "" if caller.identity is None else caller.identity.role.name.lower()
        told = {"name": caller.name, "address": caller.address, "role": role}
        answer(call, lambda _request: {"success": True, "message": json.dumps(told)})

    def _answer(self, call: Call, refusal: str | None) -> None:
        message = self._sentence() if refusal is None else refusal
        answer(call, lambda _request: {"success": refusal is None, "message": message})

    def _sentence(self) -> str:
        if self._lease.policy == "shared":
            return "all clients may drive the arm at once (access.control)"
        if self._lease.holder is None:
            return "nobody controls the arm; the first who moves it does"
        return f"{self._lease.holder} controls the arm"

    def _publish(self) -> None:
        lease, now_s = self._lease, self._clock()
        holder = lease.holder
        values = {
            "holder": "" if holder is None else holder.name,
            "address": "" if holder is None else holder.address,
            "policy": lease.policy,
            "since": "" if holder is None else f"{lease.since_s:.3f}",
            "idle_s": f"{lease.idle_s(now_s):.0f}",
            "free_in_s": "" if holder is None else f"{lease.free_in_s(now_s):.0f}",
        }
        status: dict[str, Any] = {
            "level": LEVEL_OK,
            "name": "control",
            "message": self._sentence(),
            "hardware_id": values["holder"],
            "values": key_values(values),
        }
        self._graph.publish(self._node, TOPIC, status)
