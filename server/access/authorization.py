"""Authorization: the table of the role and the control that each name needs, and the check of each operation."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from protocol.operations import (
    Advertise,
    AdvertiseAction,
    AdvertiseService,
    Auth,
    CallService,
    CancelActionGoal,
    Operation,
    Publish,
    SendActionGoal,
    Subscribe,
    qualify,
)
from server.access.authentication import RosauthVerifier, Tokens
from server.access.control_lease import ControlLease
from server.access.one_time_tokens import VALID_FOR_S, OneTimeTokens
from server.access.rate_limits import RateLimiter
from server.access.settings import AccessSettings
from server.execution.queue import RunningGoal
from server.graph.node import Node
from server.graph.permissions import Identity, NameFilter, Role
from server.graph.topics import Graph

# Suffixes of the names by which actions are cancelled and, as actionlib's topics, sent.
CANCEL_SERVICE = "/_action/cancel_goal"
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
    "field token: it is none of the tokens here; a one-time token lets one connection in, within"
    f" {VALID_FOR_S:g} s after it was issued"
)

_WHAT_TO_SHOW = {
    Role.VIEW: "a token",
    Role.OPERATE: "a token of access.operate_tokens or access.admin_tokens",
    Role.ADMIN: "a token of access.admin_tokens",
}

# Open beside every filter of services, as in rosbridge_server: clients find out with them what there is.
ALWAYS_SERVICES = ("/rosapi/*",)


@dataclass(frozen=True)
class Rule:
    """Requirements of a service, a topic or an action.

    Attributes:
        role: least role of the client.
        stops: True for names that stop the arm; they are open to every client with the role, past filters and control,
            as far as they lead to something that can be stopped.
        at_once: True for names that go ahead of everything that waits.
        at_once_data: text in the field ``data`` with which alone a message does so; None for any message.
        drives: True for names that move or switch the arm, which one client does at a time.
        goal: True for names that count against the rate of goals.
        plan_only: path of the field in a goal that may say that nothing moves; empty where there is none.
        plans: True for services whose answer takes a planner; the calls of one client that wait for it are limited.
    """

    role: Role
    stops: bool = False
    at_once: bool = False
    at_once_data: str | None = None
    drives: bool = False
    goal: bool = False
    plan_only: tuple[str, ...] = ()
    plans: bool = False


LOOKING = Rule(Role.VIEW)
PLANNING = Rule(Role.VIEW, plans=True)
CANCELLING = Rule(Role.VIEW, stops=True)
STOPPING = Rule(Role.VIEW, stops=True, at_once=True)
STOP_EVENT = Rule(Role.VIEW, stops=True, at_once=True, at_once_data="stop")
WORKING = Rule(Role.OPERATE)
SWITCHING = Rule(Role.OPERATE, drives=True)
GOAL = Rule(Role.OPERATE, drives=True, goal=True)
PLANNING_GOAL = Rule(Role.OPERATE, drives=True, goal=True, plan_only=("planning_options", "plan_only"))
CALLED_GOAL = Rule(Role.OPERATE, drives=True, goal=True, plan_only=("plan_only",), plans=True)
CONFIGURING = Rule(Role.ADMIN)
COMMISSIONING = Rule(Role.ADMIN, drives=True)

_ROSAPI_LOOKING = (
    "action_feedback_details",
    "action_goal_details",
    "action_result_details",
    "action_servers",
    "action_type",
    "get_param",
    "get_param_names",
    "get_ros_version",
    "get_time",
    "has_param",
    "interfaces",
    "message_details",
    "node_details",
    "nodes",
    "publishers",
    "search_param",
    "service_host",
    "service_node",
    "service_providers",
    "service_request_details",
    "service_response_details",
    "service_type",
    "services",
    "services_for_type",
    "subscribers",
    "topic_type",
    "topics",
    "topics_and_raw_types",
    "topics_for_type",
)

SERVICES: Mapping[str, Rule] = {
    **{f"/rosapi/{name}": LOOKING for name in _ROSAPI_LOOKING},
    "/rosapi/delete_param": CONFIGURING,
    "/rosapi/set_param": CONFIGURING,
    "/apply_planning_scene": WORKING,
    "/arm/commissioning/answer": COMMISSIONING,
    "/arm/commissioning/begin": COMMISSIONING,
    "/arm/commissioning/cancel": CONFIGURING,
    "/arm/emergency_stop": STOPPING,
    "/arm/enable": SWITCHING,
    # It slows the arm down to rest, which harms nobody.
    "/arm/park": SWITCHING,
    "/arm/pause": WORKING,
    "/arm/relax": SWITCHING,
    "/arm/release_control": WORKING,
    "/arm/reset_fault": SWITCHING,
    "/arm/resume": SWITCHING,
    "/arm/scenes/delete": CONFIGURING,
    "/arm/scenes/list": LOOKING,
    "/arm/scenes/load": WORKING,
    "/arm/scenes/save": CONFIGURING,
    "/arm/servo_history": LOOKING,
    # It moves nothing: an operator may lower it while another client drives.
    "/arm/set_speed_limit": WORKING,
    "/arm/step_back": SWITCHING,
    "/arm/stop": STOPPING,
    "/arm/take_control": WORKING,
    "/arm/who_am_i": LOOKING,
    "/armbridge/get_logger_levels": LOOKING,
    "/armbridge/goal_history": LOOKING,
    "/armbridge/goal_record": LOOKING,
    "/armbridge/issue_one_time_token": CONFIGURING,
    # Lines name addresses and files.
    "/armbridge/last_log_lines": CONFIGURING,
    "/armbridge/set_logger_levels": CONFIGURING,
    "/check_goals": PLANNING,
    "/check_state_validity": PLANNING,
    "/clear_octomap": WORKING,
    "/compute_cartesian_path": PLANNING,
    "/compute_fk": LOOKING,
    "/compute_ik": PLANNING,
    "/dataset/discard_episode": WORKING,
    "/dataset/start_episode": WORKING,
    "/dataset/stop_episode": WORKING,
    "/delete_robot_state": CONFIGURING,
    "/file_server/get_file": LOOKING,
    "/get_planner_params": LOOKING,
    "/get_planning_scene": LOOKING,
    "/get_robot_state": LOOKING,
    "/get_urdf": LOOKING,
    "/has_robot_state": LOOKING,
    "/list_robot_states": LOOKING,
    "/load_geometry_from_file": WORKING,
    "/moveit_goal": CALLED_GOAL,
    "/moveit_goal_confirm_mode": CONFIGURING,
    "/plan_kinematic_path": PLANNING,
    "/plan_sequence_path": PLANNING,
    "/query_planner_interface": LOOKING,
    "/rename_robot_state": CONFIGURING,
    "/save_geometry_to_file": CONFIGURING,
    "/save_robot_state": CONFIGURING,
    "/servo_node/pause_servo": SWITCHING,
    "/servo_node/reset_servo_status": SWITCHING,
    "/servo_node/start_servo": SWITCHING,
    "/servo_node/stop_servo": STOPPING,
    "/servo_node/switch_command_type": SWITCHING,
    "/servo_node/unpause_servo": SWITCHING,
    "/set_planner_params": CONFIGURING,
    # To record moves nothing; the client that teaches is one that may also drive.
    "/teach/begin": WORKING,
    "/teach/check": PLANNING,
    "/teach/delete": CONFIGURING,
    "/teach/discard": WORKING,
    "/teach/end": WORKING,
    "/teach/get": LOOKING,
    "/teach/list": LOOKING,
    "/teach/rename": CONFIGURING,
    "/teach/save": CONFIGURING,
    "/teach/trim": CONFIGURING,
    "/teleop/clutch": SWITCHING,
    "/teleop/start": SWITCHING,
    "/teleop/stop": STOPPING,
}

# Rules of publishing; to subscribe needs LOOKING alone.
TOPICS: Mapping[str, Rule] = {
    "/arm/speed_factor": SWITCHING,
    "/attached_collision_object": WORKING,
    "/collision_object": WORKING,
    "/dataset/episode": WORKING,
    "/emergency_stop": STOPPING,
    "/moveit_goal_cancel": CANCELLING,
    # The client that confirms may be another than the one that drives.
    "/moveit_goal_confirm": WORKING,
    # The client that chooses the group is the one that drives.
    "/moveit_goal_group": SWITCHING,
    "/moveit_goal_joints": GOAL,
    "/moveit_goal_named": GOAL,
    "/moveit_goal_pose": GOAL,
    "/planning_scene": WORKING,
    "/planning_scene_world": WORKING,
    "/servo_node/command_timeout": SWITCHING,
    "/servo_node/delta_joint_cmds": SWITCHING,
    "/servo_node/delta_twist_cmds": SWITCHING,
    "/servo_node/pose_target_cmds": SWITCHING,
    "/stop": STOPPING,
    "/trajectory_execution_event": STOP_EVENT,
}

ACTIONS: Mapping[str, Rule] = {
    "/execute_trajectory": GOAL,
    "/joint_trajectory_action": GOAL,
    "/move_action": PLANNING_GOAL,
    "/move_group": PLANNING_GOAL,
    "/moveit_goal": CALLED_GOAL,
    "/replay_motion": GOAL,
    "/sequence_move_group": PLANNING_GOAL,
}


# What each of several arms has below its own name as well, with the same rules: /left/arm/enable is /arm/enable of one.
OF_EACH_ARM = frozenset(
    (
        "/arm/commissioning/answer",
        "/arm/commissioning/begin",
        "/arm/commissioning/cancel",
        "/arm/emergency_stop",
        "/arm/enable",
        "/arm/park",
        "/arm/pause",
        "/arm/relax",
        "/arm/release_control",
        "/arm/reset_fault",
        "/arm/resume",
        "/arm/set_speed_limit",
        "/arm/speed_factor",
        "/arm/step_back",
        "/arm/stop",
        "/arm/take_control",
        "/emergency_stop",
        "/joint_trajectory_action",
        "/moveit_goal",
        "/moveit_goal_cancel",
        "/moveit_goal_group",
        "/moveit_goal_joints",
        "/moveit_goal_named",
        "/moveit_goal_pose",
        "/servo_node/command_timeout",
        "/servo_node/delta_joint_cmds",
        "/servo_node/delta_twist_cmds",
        "/servo_node/pause_servo",
        "/servo_node/pose_target_cmds",
        "/servo_node/reset_servo_status",
        "/servo_node/start_servo",
        "/servo_node/stop_servo",
        "/servo_node/switch_command_type",
        "/servo_node/unpause_servo",
        "/stop",
        "/teleop/clutch",
        "/teleop/start",
        "/teleop/stop",
        "/trajectory_execution_event",
    )
)


NO_NAMES: Collection[str] = frozenset()


def arm_and_name(name: str, arms: Collection[str]) -> tuple[str, str]:
    """Return the arm below whose name a name stands, and the rest; without one, an empty text and the name itself.

    Args:
        name: fully qualified.
        arms: names of several arms; empty for one.
    """
    arm, slash, rest = name[1:].partition("/")
    below = slash + rest
    if arm in arms and (below in OF_EACH_ARM or below.endswith((*CONTROLLER_ACTIONS, FOLLOW_TOPIC))):
        return arm, below
    return "", name


def rule_of_service(name: str, arms: Collection[str] = NO_NAMES) -> Rule:
    """Return the rule of a service, given by its fully qualified name, on a server with these several arms."""
    if name.endswith(CANCEL_SERVICE):
        return CANCELLING
    return SERVICES.get(arm_and_name(name, arms)[1], WORKING)


def rule_of_action(name: str, arms: Collection[str] = NO_NAMES) -> Rule:
    """Return the rule of an action, as :func:`rule_of_service`."""
    return GOAL if name.endswith(CONTROLLER_ACTIONS) else ACTIONS.get(arm_and_name(name, arms)[1], WORKING)


def rule_of_topic(name: str, arms: Collection[str] = NO_NAMES) -> Rule:
    """Return the rule of publishing on a topic, as :func:`rule_of_service`."""
    rule = TOPICS.get(arm_and_name(name, arms)[1])
    if rule is not None:
        return rule
    if name.endswith(FOLLOW_TOPIC):
        return GOAL
    if name.endswith(ACTIONLIB_GOAL):
        return rule_of_action(name.removesuffix(ACTIONLIB_GOAL), arms)
    if name.endswith(ACTIONLIB_CANCEL) and rule_of_action(name.removesuffix(ACTIONLIB_CANCEL), arms).drives:
        return CANCELLING
    return WORKING


def is_stop(operation: Operation, arms: Collection[str] = NO_NAMES) -> bool:
    """Return True for an operation that stops the arm, ahead of everything that waits."""
    match operation:
        case Publish():
            rule = TOPICS.get(arm_and_name(qualify(operation.topic), arms)[1], WORKING)
            return rule.at_once and rule.at_once_data in (None, operation.msg.get("data"))
        case CallService():
            return rule_of_service(_name_of(operation.service), arms).at_once
        case _:
            return False


def is_cancel(operation: Operation, arms: Collection[str] = NO_NAMES) -> bool:
    """Return True for an operation that cancels a goal."""
    match operation:
        case CancelActionGoal():
            return True
        case Publish():
            return rule_of_topic(qualify(operation.topic), arms) is CANCELLING
        case CallService():
            return rule_of_service(_name_of(operation.service), arms) is CANCELLING
        case _:
            return False


def _name_of(service: str) -> str:
    # What follows the sign is the call's id.
    return qualify(service.partition("#")[0])


def plans_only(rule: Rule, goal: object) -> bool:
    """Return True for a goal, as its client spelled it, that asks for a plan and for no motion."""
    value = goal
    for field in rule.plan_only:
        value = value.get(field) if isinstance(value, Mapping) else None
    return bool(rule.plan_only) and value is True


class Authorizer:
    """Check of the operations of one client; asked once an operation, before anything is done for it.

    Args:
        node: the client.
        access: rules that all clients share.
        graph: the topics and actions that there are.
    """

    __slots__ = ("_access", "_goals", "_graph", "_node", "_settled")

    def __init__(self, node: Node, access: Access, graph: Graph) -> None:
        self._node = node
        self._access = access
        self._graph = graph
        self._goals = RateLimiter(access.settings.goals_per_s, access.settings.goal_burst)
        # Topics as the client spells them: it publishes on the same few, thousands of times a second.
        self._settled: set[str] = set()
        access.note_driver(node)

    @property
    def arms(self) -> Collection[str]:
        """Names of several arms; empty for one."""
        return self._access.leases_of_arms.keys()

    def may_publish(self, topic: str) -> bool:
        """Return True for a topic, as the client spells it, on which it is known to be allowed any message."""
        return topic in self._settled

    def refusal(self, operation: Operation) -> str | None:
        """Return the reason why an operation is refused, None when it is not; one that drives takes control."""
        match operation:
            case Publish():
                known = operation.topic in self._settled
                return None if known else self.publishing(operation.topic, operation.msg)
            case CallService():
                return self.calling(operation.service, operation.args)
            case SendActionGoal():
                name = qualify(operation.action)
                rule = rule_of_action(name, self.arms)
                return self._name_refusal(rule, "action", name) or self._drive(rule, name, operation.args)
            case Subscribe():
                return self._name_refusal(LOOKING, "topic", qualify(operation.topic))
            case Advertise():
                name = qualify(operation.topic)
                return self._name_refusal(self._rule_of_publishing(name), "topic", name)
            case AdvertiseService():
                return self._name_refusal(WORKING, "service", qualify(operation.service))
            case AdvertiseAction():
                return self._name_refusal(WORKING, "action", qualify(operation.action))
            case _:
                return None

    def authenticate(self, identity: Identity) -> None:
        """Give the client the identity that it has shown."""
        self._node.identity = identity
        self._settled.clear()
        self._access.note_driver(self._node)
        if identity.role < Role.OPERATE:
            self._access.give_back(self._node)

    def leave(self) -> None:
        """Free the control of a client that has left."""
        self._access.drivers.discard(self._node)
        self._access.give_back(self._node)

    def publishing(self, topic: str, message: Mapping[str, Any]) -> str | None:
        """Check a message on a topic, as :meth:`refusal`."""
        name = qualify(topic)
        rule = self._rule_of_publishing(name)
        refusal = self._name_refusal(rule, "topic", name)
        if refusal is None and name.endswith(ACTIONLIB_GOAL) and rule.goal:
            # The other way to an action must not be the one past its filter.
            refusal = self._access.services.refusal("action", name.removesuffix(ACTIONLIB_GOAL))
        settled = refusal is None and not rule.drives and not rule.stops
        if settled and len(self._settled) < MAX_SETTLED:
            self._settled.add(topic)
        return refusal or self._drive(rule, name, message.get("goal"))

    def calling(self, service: str, arguments: object) -> str | None:
        """Check a call of a service with its request, as :meth:`refusal`."""
        name = _name_of(service)
        rule = rule_of_service(name, self.arms)
        if name.endswith(CANCEL_SERVICE) and self._graph.actions.provider(name.removesuffix(CANCEL_SERVICE)) is None:
            # It belongs to no action, so it stops nothing.
            rule = WORKING
        return self._name_refusal(rule, "service", name) or self._drive(rule, name, arguments)

    def _rule_of_publishing(self, name: str) -> Rule:
        """Return the rule of a topic, that of any other topic for one that would stop nothing.

        A topic that stops exists, with its type: else a client that may only look could make topics, of any type.
        """
        rule = rule_of_topic(name, self.arms)
        if not rule.stops:
            return rule
        if name.endswith(ACTIONLIB_CANCEL):
            action = self._graph.actions.provider(name.removesuffix(ACTIONLIB_CANCEL))
            stops = action is not None and self._graph.topic_type(name) == ACTIONLIB_CANCEL_TYPE
        else:
            stops = any(not node.remote for node in self._graph.subscribers(name))
        return rule if stops else WORKING

    def _name_refusal(self, rule: Rule, kind: Literal["topic", "service", "action"], name: str) -> str | None:
        identity = self._node.identity
        if identity is None or identity.role < rule.role:
            has = "none" if identity is None else identity.role.name.lower()
            return (
                f"{kind} {name}: needs the role {rule.role.name.lower()}, this client has {has}; "
                f"show {_WHAT_TO_SHOW[rule.role]}"
            )
        names = self._access.topics if kind == "topic" else self._access.services
        return None if rule.stops else names.refusal(kind, name)

    def _drive(self, rule: Rule, name: str, goal: object) -> str | None:
        if rule.goal and not self._goals.take(self._access.clock()):
            return (
                f"{name}: this client sends more than {self._goals.burst} goals at once (access.goal_burst) and "
                f"{self._goals.per_s:g} a second (access.goals_per_s)"
            )
        if not rule.drives or plans_only(rule, goal):
            return None
        refusal = self._access.lease_of(name).drive(self._node, self._access.clock())
        return None if refusal is None else f"{name}: {refusal}"


NO_ARMS: Mapping[str, Callable[[], RunningGoal | None]] = MappingProxyType({})


class Access:
    """Authentication and authorization as the settings describe them.

    Args:
        settings: the section ``access``.
        clock: monotonic time [s].
        wall_clock: seconds since the epoch.
        busy: returns the goal that is worked on.
        arms: by the name of each of several arms, what returns the goal that is worked on there.

    Attributes:
        settings: as given.
        clock: as given.
        tokens: tokens and their owners.
        one_time_tokens: tokens that let one connection in each.
        lease: control of the arm, or of all arms.
        leases_of_arms: control of each of several arms, by its name.
        drivers: clients that are connected and whose role lets them drive.
        topics: filter of topics.
        services: filter of services and actions.
        params: filter of parameters.

    Raises:
        ConfigurationError: the tokens cannot be used.
    """

    def __init__(
        self,
        settings: AccessSettings,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        busy: Callable[[], RunningGoal | None] = lambda: None,
        arms: Mapping[str, Callable[[], RunningGoal | None]] = NO_ARMS,
    ) -> None:
        self.tokens = Tokens.from_settings(settings)
        self.one_time_tokens = OneTimeTokens(clock)
        policy, idle_s = settings.control, settings.control_idle_s
        self.lease = ControlLease(policy, idle_s, wall_clock, busy, "all arms" if arms else "the arm")
        self.leases_of_arms = {
            name: ControlLease(policy, idle_s, wall_clock, busy_there, f"the arm {name}")
            for name, busy_there in arms.items()
        }
        self.lease.excluded_by = tuple(self.leases_of_arms.values())
        for lease in self.leases_of_arms.values():
            lease.excluded_by = (self.lease,)
        self.drivers: set[Node] = set()
        self.topics = NameFilter("access.topics_glob", settings.topics_glob)
        self.services = NameFilter("access.services_glob", settings.services_glob, ALWAYS_SERVICES)
        self.params = NameFilter("access.params_glob", settings.params_glob)
        self.settings = settings
        self.clock = clock
        self._wall_clock = wall_clock
        self._rosauth = RosauthVerifier(self.tokens)

    def authorizer(self, node: Node, graph: Graph) -> Authorizer:
        """Return the check of a client's operations on a graph."""
        return Authorizer(node, self, graph)

    def lease_of(self, name: str) -> ControlLease:
        """Return the control that is needed for a name: that of one arm below whose name it stands, or of all."""
        return self.leases_of_arms.get(arm_and_name(name, self.leases_of_arms)[0], self.lease)

    def give_back(self, node: Node) -> None:
        """Free every control that a client has."""
        for lease in (self.lease, *self.leases_of_arms.values()):
            lease.leave(node)

    def note_driver(self, node: Node) -> None:
        """Count a client among those that may drive, or no longer, by its present role."""
        if node.identity is not None and node.identity.role >= Role.OPERATE:
            self.drivers.add(node)
        else:
            self.drivers.discard(node)

    def identify(self, shown: Auth) -> Identity | str:
        """Return the identity that a client shows in the op ``auth``, or a sentence why it shows none."""
        if shown.token is not None:
            identity = self.tokens.identify(shown.token) or self.one_time_tokens.use(shown.token)
            return identity or _NO_TOKEN
        if shown.mac is None:
            return "wanted the field token, or rosauth's mac, client, dest, rand, t, level and end; got neither"
        return self._rosauth.identify(shown, self._wall_clock())


def unlimited() -> Access:
    """Return the access to a server on which every client may do everything at any time."""
    return Access(AccessSettings(control="shared"))
