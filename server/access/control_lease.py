"""Control of the arm: the lease that lets one client drive at a time, with its topic and services."""

import functools
import json
import math
from collections.abc import Callable
from datetime import UTC, datetime
from importlib import metadata
from typing import Literal, TypeAlias

from server.diagnostic_values import LEVEL_OK, diagnostic_status
from server.execution.queue import RunningGoal
from server.graph.permissions import LOOKING, WORKING, Node, Role
from server.graph.services import Call
from server.graph.topics import LocalGraph

Policy: TypeAlias = Literal["lease", "shared"]

RELEASE_SERVICE = "/arm/release_control"

# Time for which only the client that has released another's control may take it, however often the other asks [s].
RESERVED_S = 3.0

TOPIC = "/arm/control"
TAKE_SERVICE = "/arm/take_control"

# Answers with the client's own name, by which it finds itself on the topic.
WHO_SERVICE = "/arm/who_am_i"

# Period of the check for an idle holder, and of the messages while there is a holder [s].
BEAT_S = 1.0


class ControlLease:
    """Control of the arm by one client at a time; ``several`` means all of several arms together."""

    def __init__(
        self,
        policy: Policy,
        idle_s: float,
        wall_clock: Callable[[], float],
        busy: Callable[[], RunningGoal | None],
        namespace: str = "",
        *,
        several: bool = False,
    ) -> None:
        self.policy = policy
        # Leases that nobody else may hold when a client takes this one: the lease of all arms and the lease of each arm
        # exclude each other.
        self.excluded_by: tuple[ControlLease, ...] = ()
        self._busy = busy
        self._several = several
        self.title = "all arms" if several else f"the arm {namespace.removeprefix('/')}".rstrip()
        self._release_service = f"{namespace}{RELEASE_SERVICE}"
        self.holder: Node | None = None
        self.since_s = 0.0
        self.watchers: list[Callable[[], None]] = []  # called whenever :meth:`sentence` changes
        self._idle_limit_s = idle_s
        self._wall_clock = wall_clock
        self._heard_s = 0.0
        self._reserved: tuple[Node, float] | None = None

    def drive(self, node: Node, now_s: float) -> str | None:
        """Take control, or keep it, to move the arm or to switch it."""
        if self.policy == "shared" or not node.remote:
            return None
        if self.holder is not node:
            self.tick(now_s)
            if self.holder is not None:
                return self.refusal(self.holder, now_s)
            for other in self.excluded_by:
                other.tick(now_s)
                if other.holder is not None and other.holder is not node:
                    return other.refusal(other.holder, now_s)
            # The first to take the arm ends the reservation.
            if self._reserved is not None and self._reserved[0] is not node:
                first, until_s = self._reserved
                return f"{first} has taken control from another; it is free in {math.ceil(until_s - now_s)} s"
            self._reserved = None
        self._heard_s = now_s
        self._set(node)
        return None

    def release(self, node: Node, now_s: float) -> str | None:
        """Give control back; a client that has shown a token with the role ADMIN may take it from another."""
        if self.holder is None or self.holder is node:
            self._set(None)
            return None
        identity = node.identity
        if identity is not None and identity.by_token and identity.role >= Role.ADMIN:
            self._reserved = node, now_s + RESERVED_S
            self._set(None)
            return None
        return (
            f"{self.holder} controls {self.title}, not {node}; to take control from another, show a token of "
            "access.admin_tokens"
        )

    def leave(self, node: Node) -> None:
        """Forget a client that has left, or that may not drive any more."""
        if self._reserved is not None and self._reserved[0] is node:
            self._reserved = None
        if self.holder is node:
            self._set(None)

    def tick(self, now_s: float) -> None:
        """Free the arm when its holder has idled for too long, at a monotonic time [s]."""
        if self._reserved is not None and now_s >= self._reserved[1]:
            self._reserved = None
            self._report_change()
        if self.holder is None:
            return
        if self._busy() is not None:
            self._heard_s = now_s
        elif now_s - self._heard_s >= self._idle_limit_s:
            self._set(None)

    def idle_s(self, now_s: float) -> float:
        """Return the time since the holder's last request [s], at a monotonic time [s]."""
        return 0.0 if self.holder is None else now_s - self._heard_s

    def free_in_s(self, now_s: float) -> float:
        """Return the time until the arm is free if its holder requests nothing more and no goal waits [s]."""
        goal = self._busy()
        if goal is not None:
            return self._idle_limit_s + (goal.remaining_s or 0.0)
        return self._idle_limit_s - self.idle_s(now_s)

    def _set(self, holder: Node | None) -> None:
        if holder is self.holder:
            return
        self.holder = holder
        self.since_s = self._wall_clock()
        self._report_change()

    def _report_change(self) -> None:
        for lease in (self, *self.excluded_by):
            for on_change in lease.watchers:
                on_change()

    def sentence(self) -> str:
        """Return the sentence about the client in control, also by control of other arms together with this."""
        for lease in (self, *self.excluded_by):
            if lease.holder is not None:
                return f"{lease.holder} controls {lease.title}"
        if self.policy == "shared":
            return f"all clients may drive {self.title} at once (access.control)"
        if self._reserved is not None:
            return f"nobody controls {self.title}; for {RESERVED_S:g} s only {self._reserved[0]} may take it"
        return f"nobody controls {self.title}; the first who moves {'them' if self._several else 'it'} does"

    def refusal(self, holder: Node, now_s: float) -> str:
        """Return the sentence that refuses control, because a client has it."""
        goal, idle = self._busy(), f"(access.control_idle_s = {self._idle_limit_s:g})"
        if goal is None:
            running, left = "", f"asks for nothing for another {math.ceil(self.free_in_s(now_s))} s"
        else:
            running = f", and {self._describe(goal)}"
            left = f"has asked for nothing for {self._idle_limit_s:g} s after the last goal"
        return (
            f"{holder} has controlled {self.title} since {_time_of_day(self.since_s)}{running}; it is free when that "
            f"client leaves, calls {self._release_service}, or {left} {idle}"
        )

    def _describe(self, goal: RunningGoal) -> str:
        behind = f", and {goal.waiting} more wait behind it" if goal.waiting else ""
        if goal.remaining_s is None:
            return f"{goal.title} is worked on, whose motion has not begun{behind}"
        ends = _time_of_day(self._wall_clock() + goal.remaining_s)
        return f"{goal.title} runs until about {ends}, in {math.ceil(goal.remaining_s)} s{behind}"


def _time_of_day(stamp_s: float) -> str:
    return datetime.fromtimestamp(stamp_s, UTC).strftime("%H:%M:%S UTC")


class ControlServices:
    """Topic ``/arm/control`` (latched), and the services that take, release and ask for control."""

    def __init__(self, graph: LocalGraph, lease: ControlLease) -> None:
        self._lease = lease
        self._node = graph.node("arm control")
        self._node.advertise(TOPIC, "diagnostic_msgs/DiagnosticStatus", latch=True)
        for name, change in ((TAKE_SERVICE, lease.drive), (RELEASE_SERVICE, lease.release)):
            serve = functools.partial(self._answer, change)
            self._node.offer_calls(name, "std_srvs/Trigger", serve, rule=WORKING)
        self._node.offer_calls(WHO_SERVICE, "std_srvs/Trigger", self._who, rule=LOOKING)
        lease.watchers.append(self._publish)
        self._publish()
        self._timer = self._node.call_later(BEAT_S, self._beat)

    def close(self) -> None:
        self._timer.cancel()

    def _beat(self) -> None:
        self._lease.tick(self._node.clock())
        if self._lease.holder is not None:
            self._publish()
        self._timer = self._node.call_later(BEAT_S, self._beat)

    def _who(self, call: Call) -> None:
        caller = call.caller
        role = "" if caller.identity is None else caller.identity.role.name.lower()
        names = {"name": caller.name, "address": caller.address, "role": role, "version": metadata.version("armbridge")}
        call.succeed({"success": True, "message": json.dumps(names)})

    def _answer(self, change: Callable[[Node, float], str | None], call: Call) -> None:
        refusal = change(call.caller, self._node.clock())
        message = self._lease.sentence() if refusal is None else refusal
        call.succeed({"success": refusal is None, "message": message})

    def _publish(self) -> None:
        lease, now_s = self._lease, self._node.clock()
        holder = lease.holder
        values = {
            "holder": "" if holder is None else holder.name,
            "address": "" if holder is None else holder.address,
            "policy": lease.policy,
            "since": "" if holder is None else f"{lease.since_s:.3f}",
            "idle_s": f"{lease.idle_s(now_s):.0f}",
            "free_in_s": "" if holder is None else f"{lease.free_in_s(now_s):.0f}",
        }
        self._node.publish(TOPIC, diagnostic_status(LEVEL_OK, "control", lease.sentence(), values, values["holder"]))
