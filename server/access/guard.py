"""What one client may do: asked once an operation, before anything is done for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from protocol.names import qualify
from protocol.operations import (
    Advertise,
    AdvertiseAction,
    AdvertiseService,
    CallService,
    Operation,
    Publish,
    SendActionGoal,
    Subscribe,
)
from server.access import rules
from server.access.globs import Globs
from server.access.lease import Lease
from server.access.rates import Rate
from server.access.roles import Identity, Role
from server.access.rules import Rule
from server.graph.node import Node

# Topics that a client is known to may use; one that uses more is asked anew for each.
MAX_SETTLED = 1000

_WHAT_TO_SHOW = {
    Role.VIEW: "a token",
    Role.OPERATE: "a token of access.operate_tokens or access.admin_tokens",
    Role.ADMIN: "a token of access.admin_tokens",
}


@dataclass(frozen=True)
class Shared:
    """What holds for all clients alike.

    Attributes:
        topics: which topics they may use.
        services: which services and actions.
        lease: who drives the arm.
    """

    topics: Globs
    services: Globs
    lease: Lease


class Guard:
    """Lets the operations of one client through, or says why not.

    Args:
        node: the client.
        shared: what holds for all.
        goals: how many goals it may send.
        clock: monotonic time [s].
    """

    __slots__ = ("_clock", "_goals", "_node", "_settled", "_shared")

    def __init__(self, node: Node, shared: Shared, goals: Rate, clock: Callable[[], float]) -> None:
        self._node = node
        self._shared = shared
        self._goals = goals
        self._clock = clock
        # As they are spelled, for a client publishes on the same few thousands of times a second.
        self._settled: set[str] = set()

    def refusal(self, operation: Operation) -> str | None:
        """Why an operation is not carried out, a sentence; None when it is. One that drives takes control.

        Args:
            operation: as it came.
        """
        check = _CHECKS.get(type(operation))
        return None if check is None else check(self, operation)

    def become(self, identity: Identity) -> None:
        """The client has shown who it is."""
        self._node.identity = identity
        self._settled.clear()
        if identity.role < Role.OPERATE:
            self._shared.lease.leave(self._node)

    def leave(self) -> None:
        """The client has left."""
        self._shared.lease.leave(self._node)

    def of_publish(self, operation: Publish) -> str | None:
        """As :meth:`refusal`, for a message."""
        if operation.topic in self._settled:
            return None
        return self.publishing(operation.topic, operation.msg)

    def publishing(self, topic: str, message: Mapping[str, Any]) -> str | None:
        """As :meth:`refusal`, for a message on a topic."""
        name = qualify(topic)
        rule = rules.of_topic(name)
        refusal = self._name_refusal(rule, "topic", name, self._shared.topics)
        if refusal is None and name.endswith(rules.ACTIONLIB_GOAL) and rule.goal:
            # The other way to an action must not be the one past its globs.
            refusal = self._shared.services.refusal("action", name.removesuffix(rules.ACTIONLIB_GOAL))
        if refusal is None and not rule.drives and len(self._settled) < MAX_SETTLED:
            self._settled.add(topic)
        return refusal or self._drive(rule, name, message.get("goal"))

    def advertising(self, topic: str) -> str | None:
        """As :meth:`refusal`, for whoever is going to publish on a topic."""
        name = qualify(topic)
        return self._name_refusal(rules.of_topic(name), "topic", name, self._shared.topics)

    def subscribing(self, topic: str) -> str | None:
        """As :meth:`refusal`, for a subscription to a topic."""
        return self._name_refusal(rules.LOOKING, "topic", qualify(topic), self._shared.topics)

    def calling(self, service: str) -> str | None:
        """As :meth:`refusal`, for a call of a service."""
        # What follows the sign is the call's id.
        name = qualify(service.partition("#")[0])
        rule = rules.of_service(name)
        return self._name_refusal(rule, "service", name, self._shared.services) or self._drive(rule, name, None)

    def sending(self, action: str, goal: object) -> str | None:
        """As :meth:`refusal`, for a goal on an action."""
        name = qualify(action)
        rule = rules.of_action(name)
        return self._name_refusal(rule, "action", name, self._shared.services) or self._drive(rule, name, goal)

    def offering(self, kind: str, spelled: str) -> str | None:
        """As :meth:`refusal`, for whoever is going to answer calls or goals."""
        return self._name_refusal(rules.WORKING, kind, qualify(spelled), self._shared.services)

    def _name_refusal(self, rule: Rule, kind: str, name: str, globs: Globs) -> str | None:
        identity = self._node.identity
        if identity is None or identity.role < rule.role:
            has = "none" if identity is None else identity.role.name.lower()
            return (
                f"{kind} {name}: needs the role {rule.role.name.lower()}, this client has {has}; "
                f"show {_WHAT_TO_SHOW[rule.role]}"
            )
        return None if rule.stops else globs.refusal(kind, name)

    def _drive(self, rule: Rule, name: str, goal: object) -> str | None:
        if rule.goal and not self._goals.take(self._clock()):
            return (
                f"{name}: this client sends more than {self._goals.burst} goals at once (access.goal_burst) and "
                f"{self._goals.per_s:g} a second (access.goals_per_s)"
            )
        if not rule.drives or (rule.may_plan_only and rules.plans_only(goal)):
            return None
        refusal = self._shared.lease.drive(self._node, self._clock())
        return None if refusal is None else f"{name}: {refusal}"


# One table for all clients, of whom there may be many.
_Check: TypeAlias = Callable[[Guard, Any], str | None]
_CHECKS: Mapping[type[Operation], _Check] = {
    Publish: Guard.of_publish,
    Advertise: lambda guard, operation: guard.advertising(operation.topic),
    Subscribe: lambda guard, operation: guard.subscribing(operation.topic),
    CallService: lambda guard, operation: guard.calling(operation.service),
    SendActionGoal: lambda guard, operation: guard.sending(operation.action, operation.args),
    AdvertiseService: lambda guard, operation: guard.offering("service", operation.service),
    AdvertiseAction: lambda guard, operation: guard.offering("action", operation.action),
}
