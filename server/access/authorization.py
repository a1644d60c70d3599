"""Authorization: the check of each operation against the rule of its name, which stands where the name is offered."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Literal

from protocol import operations as ops
from protocol.operations import Operation, qualify
from server.access.authentication import Tokens
from server.access.control_lease import ControlLease
from server.access.one_time_tokens import VALID_FOR_S, OneTimeTokens
from server.access.rate_limits import RateLimiter
from server.access.settings import AccessSettings
from server.execution.queue import RunningGoal
from server.graph.actions import CANCEL_SERVICE
from server.graph.permissions import CANCELLING, GOAL, LOOKING, WORKING, Identity, NameFilter, Node, Role, Rule
from server.graph.topics import Graph

# Ends of the names of actionlib's topics by which actions are sent and cancelled.
ACTIONLIB_GOAL, ACTIONLIB_CANCEL = "/goal", "/cancel"
ACTIONLIB_CANCEL_TYPE = "actionlib_msgs/msg/GoalID"

# The names of controllers begin with their joint group's.
FOLLOW_TOPIC = "_controller/joint_trajectory"
CONTROLLER_ACTIONS = tuple(
    f"_controller/{action}" for action in ("follow_joint_trajectory", "gripper_action", "gripper_cmd")
)

# Topics that a client is known to be allowed to publish on; those beyond are checked for each message.
MAX_SETTLED = 1000

_NO_TOKEN = (
    f"field token: invalid token; a one-time token lets one connection in, within {VALID_FOR_S:g} s after it was issued"
)

_TOKENS_OF_ROLE = {
    Role.VIEW: "a token",
    Role.PROPOSE: "a token of access.propose_tokens, access.operate_tokens or access.admin_tokens",
    Role.OPERATE: "a token of access.operate_tokens or access.admin_tokens",
    Role.ADMIN: "a token of access.admin_tokens",
}

# Open beside every filter of services, as in rosbridge_server: clients look names up by them.
ALWAYS_SERVICES = ("/rosapi/*",)


def rule_of_service(name: str, graph: Graph) -> Rule:
    """Return the rule of a service, given by its fully qualified name."""
    return CANCELLING if name.endswith(CANCEL_SERVICE) else graph.services.rules.get(name, WORKING)


def rule_of_action(name: str, graph: Graph) -> Rule:
    return graph.actions.rules.get(name) or (GOAL if name.endswith(CONTROLLER_ACTIONS) else WORKING)


def rule_of_topic(name: str, graph: Graph) -> Rule:
    """Return the rule of publishing on a topic, as :func:`rule_of_service`."""
    rule = graph.rules.get(name)
    if rule is not None:
        return rule
    if name.endswith(FOLLOW_TOPIC):
        return GOAL
    if name.endswith(ACTIONLIB_GOAL):
        return rule_of_action(name.removesuffix(ACTIONLIB_GOAL), graph)
    if name.endswith(ACTIONLIB_CANCEL):
        rule = rule_of_action(name.removesuffix(ACTIONLIB_CANCEL), graph)
        return CANCELLING if rule.drives else rule
    return WORKING


def is_stop(operation: Operation, graph: Graph) -> bool:
    """Return True for an operation that stops the arm, ahead of everything that waits."""
    match operation:
        case ops.Publish():
            rule = graph.rules.get(qualify(operation.topic), WORKING)
            return rule.at_once and rule.at_once_data in (None, _value_at(operation.msg, ("data",)))
        case ops.CallService():
            return rule_of_service(_name_of(operation.service), graph).at_once
        case _:
            return False


def is_cancel(operation: Operation, graph: Graph) -> bool:
    match operation:
        case ops.CancelActionGoal():
            return True
        case ops.Publish():
            return rule_of_topic(qualify(operation.topic), graph).cancels
        case ops.CallService():
            return rule_of_service(_name_of(operation.service), graph).cancels
        case _:
            return False


def _name_of(service: str) -> str:
    # What follows the sign is the call's id.
    return qualify(service.partition("#")[0])


def plans_only(rule: Rule, goal: object) -> bool:
    """Return True for a goal, as its client spelled it, that asks for a plan and for no motion."""
    return bool(rule.plan_only) and _value_at(goal, rule.plan_only) is True


def _value_at(message: object, path: tuple[str, ...]) -> object:
    """Return the value of a field of a message, as its client spelled it; None where there is none."""
    for field in path:
        message = message.get(field) if isinstance(message, Mapping) else None
    return message


class Authorizer:
    """Check of the operations of one client; asked once an operation, before anything is done for it."""

    __slots__ = ("_access", "_goals", "_graph", "_node", "settled")

    def __init__(self, node: Node, access: Access, graph: Graph) -> None:
        self._node = node
        self._access = access
        self._graph = graph
        self._goals = RateLimiter(access.settings.goals_per_s, access.settings.goal_burst)
        # Topics, as the client spells them, on which it may publish any message, thousands of times a second.
        self.settled: set[str] = set()
        access.note_driver(node)

    def refusal(self, operation: Operation) -> str | None:
        """Return the reason for a refusal, or None; an operation that drives takes control."""
        match operation:
            case ops.Publish():
                return None if operation.topic in self.settled else self.publishing(operation.topic, operation.msg)
            case ops.CallService():
                return self.calling(operation.service, operation.args)
            case ops.SendActionGoal():
                name = qualify(operation.action)
                rule = rule_of_action(name, self._graph)
                return self.name_refusal(rule, "action", name) or self._drive(rule, name, operation.args)
            case ops.Subscribe():
                return self.name_refusal(LOOKING, "topic", qualify(operation.topic))
            case ops.Advertise():
                name = qualify(operation.topic)
                return self.name_refusal(self._rule_of_publishing(name), "topic", name)
            case ops.AdvertiseService():
                return self.name_refusal(WORKING, "service", qualify(operation.service))
            case ops.AdvertiseAction():
                return self.name_refusal(WORKING, "action", qualify(operation.action))
            case _:
                return None

    def authenticate(self, identity: Identity) -> None:
        self._node.identity = identity
        self.settled.clear()
        self._access.note_driver(self._node)
        if identity.role < Role.OPERATE:
            self._access.give_back(self._node)

    def leave(self) -> None:
        self._access.drivers.discard(self._node)
        self._access.give_back(self._node)

    def publishing(self, topic: str, message: object) -> str | None:
        """Check a message on a topic, as :meth:`refusal`."""
        name = qualify(topic)
        rule = self._rule_of_publishing(name)
        refusal = self.name_refusal(rule, "topic", name)
        if refusal is None and name.endswith(ACTIONLIB_GOAL) and rule.goal:
            # The other way to an action must not be the one past its filter.
            refusal = self._access.services.refusal("action", name.removesuffix(ACTIONLIB_GOAL))
        settled = refusal is None and not rule.drives and not rule.stops
        if settled and len(self.settled) < MAX_SETTLED:
            self.settled.add(topic)
        return refusal or self._drive(rule, name, _value_at(message, ("goal",)))

    def calling(self, service: str, arguments: object) -> str | None:
        """Check a call of a service with its request, as :meth:`refusal`."""
        name = _name_of(service)
        rule = rule_of_service(name, self._graph)
        if name.endswith(CANCEL_SERVICE) and self._graph.actions.provider(name.removesuffix(CANCEL_SERVICE)) is None:
            # It belongs to no action, so it stops nothing.
            rule = WORKING
        return self.name_refusal(rule, "service", name) or self._drive(rule, name, arguments)

    def _rule_of_publishing(self, name: str) -> Rule:
        """Return the rule of a topic; a stop topic that would stop nothing has the rule of any other topic."""
        rule = rule_of_topic(name, self._graph)
        if not rule.stops:
            return rule
        if name.endswith(ACTIONLIB_CANCEL):
            action = self._graph.actions.provider(name.removesuffix(ACTIONLIB_CANCEL))
            stops = action is not None and self._graph.topic_type(name) == ACTIONLIB_CANCEL_TYPE
        else:
            stops = any(not node.remote for node in self._graph.subscribers(name))
        return rule if stops else WORKING

    def name_refusal(self, rule: Rule, kind: Literal["topic", "service", "action"], name: str) -> str | None:
        """Return the reason why the client's role, or a setting, never allows a name; None when both allow it."""
        identity = self._node.identity
        if identity is None or identity.role < rule.role:
            has = "none" if identity is None else identity.role.name.lower()
            return (
                f"{kind} {name}: needs the role {rule.role.name.lower()}, this client has {has}; "
                f"show {_TOKENS_OF_ROLE[rule.role]}"
            )
        names = self._access.topics if kind == "topic" else self._access.services
        return None if rule.stops else names.refusal(kind, name)

    def _drive(self, rule: Rule, name: str, goal: object) -> str | None:
        if rule.goal and not self._goals.take(self._access.clock()):
            return (
                f"{name}: this client sends more than {self._goals.burst} goals at once (access.goal_burst) and "
                f"{self._goals.per_s:g} a second (access.goals_per_s)"
            )
        # Of a goal that a client without the role OPERATE proposes, the client that approves it is the driver.
        if not rule.drives or self._node.is_viewer or plans_only(rule, goal):
            return None
        refusal = self._access.lease_of(rule.arm).drive(self._node, self._access.clock())
        return None if refusal is None else f"{name}: {refusal}"


class Access:
    """Authentication and authorization as the settings describe them, or ConfigurationError.

    ``busy`` returns the goal in progress, ``arms`` the goal of each of several arms by its name.
    """

    def __init__(
        self,
        settings: AccessSettings,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        busy: Callable[[], RunningGoal | None] = lambda: None,
        arms: Mapping[str, Callable[[], RunningGoal | None]] | None = None,
    ) -> None:
        self.tokens = Tokens.from_settings(settings)
        self.one_time_tokens = OneTimeTokens(clock)
        policy, idle_s = settings.control, settings.control_idle_s
        self.lease = ControlLease(policy, idle_s, wall_clock, busy, several=bool(arms))
        self.leases_of_arms = {
            name: ControlLease(policy, idle_s, wall_clock, busy_there, f"/{name}")
            for name, busy_there in (arms or {}).items()
        }
        self.lease.excluded_by = tuple(self.leases_of_arms.values())
        for lease in self.leases_of_arms.values():
            lease.excluded_by = (self.lease,)
        self.drivers: set[Node] = set()
        self.topics = NameFilter("access.topics_glob", settings.topics_glob)
        self.services = NameFilter("access.services_glob", settings.services_glob, ALWAYS_SERVICES)
        self.settings = settings
        self.clock = clock

    def lease_of(self, arm: str) -> ControlLease:
        """Return the control of one of several arms, by its name, or of all."""
        return self.leases_of_arms.get(arm, self.lease)

    def give_back(self, node: Node) -> None:
        for lease in (self.lease, *self.leases_of_arms.values()):
            lease.leave(node)

    def note_driver(self, node: Node) -> None:
        """Count a client among those that may drive, or no longer, by its present role."""
        if node.identity is not None and node.identity.role >= Role.OPERATE:
            self.drivers.add(node)
        else:
            self.drivers.discard(node)

    def identify(self, shown: ops.Auth) -> Identity | str:
        """Return the identity that a client shows in the op ``auth``, or a sentence why it shows none."""
        return self.tokens.identify(shown.token) or self.one_time_tokens.use(shown.token) or _NO_TOKEN


def unlimited() -> Access:
    """Return the access to a server on which every client may do everything at any time."""
    return Access(AccessSettings(control="shared"))
