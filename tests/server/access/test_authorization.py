import re
from collections.abc import Sequence
from typing import Any

import pytest

from harness.clients import ArmClient
from harness.server import ROOT
from protocol.operations import Auth, CallService, Publish, SendActionGoal, parse
from server.access import authorization
from server.access.authorization import MAX_SETTLED, Access, Authorizer, unlimited
from server.access.settings import AccessSettings
from server.graph import permissions
from server.graph.node import Node
from server.graph.permissions import ANYONE, WORKING, Identity, NameFilter, Role
from server.graph.topics import Graph, Subscriber
from server.moveit.services import description
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY
from tests.helpers.rules import server_rules, with_server_rules

SCREEN, OTTO, ADA = Identity("screen", Role.VIEW), Identity("otto", Role.OPERATE), Identity("ada", Role.ADMIN)


SERVER, SEVERAL = with_server_rules(Graph(REGISTRY)), with_server_rules(Graph(REGISTRY), "left", "right")

# The server listens to these, as far as the tests are about them.
STOPS = {"/stop": "std_msgs/Empty", "/emergency_stop": "std_msgs/Empty", "/move_group/cancel": "actionlib_msgs/GoalID"}


class World:
    """Clients before one server's guards, in a time of their own."""

    def __init__(self, *, arms: Sequence[str] = (), **settings: Any) -> None:
        self.now_s = 0.0
        self.graph = with_server_rules(Graph(REGISTRY, lambda: self.now_s, call_later=FakeClock().call_later), *arms)
        server = Node("server")
        for topic, type_name in STOPS.items():
            self.graph.subscribe(server, topic, type_name, Subscriber(lambda _published: None))
        for action, type_name in (("/move_group", "MoveGroup"), ("/move_action", "MoveGroup")):
            self.graph.actions.offer(server, action, f"moveit_msgs/action/{type_name}", lambda _goal: None)
        self.graph.actions.offer(
            server, "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", lambda _goal: None
        )
        idle = dict.fromkeys(arms, lambda: None)
        self.access = Access(AccessSettings.model_validate(settings), lambda: self.now_s, lambda: 0.0, arms=idle)

    def authorizer(self, identity: Identity | None = ANYONE, name: str = "x") -> Authorizer:
        return Authorizer(Node(name, remote=True, identity=identity), self.access, self.graph)


def asked(authorizer: Authorizer, op: str, **fields: Any) -> str | None:
    return authorizer.refusal(parse({"op": op, **fields}))


def test_the_clients_that_may_drive_are_known_until_they_leave_or_show_a_lower_role() -> None:
    world = World(operate_tokens={"otto": "o" * 32})
    nobody, screen, otto = world.authorizer(None), world.authorizer(SCREEN), world.authorizer(OTTO)
    assert len(world.access.drivers) == 1
    nobody.authenticate(ADA)
    assert len(world.access.drivers) == 2
    screen.leave()
    otto.authenticate(SCREEN)
    assert len(world.access.drivers) == 1
    nobody.leave()
    assert not world.access.drivers


GOAL = {"topic": "/moveit_goal_named", "msg": {"data": "home"}}

ACTION = {"action": "/move_action", "action_type": "moveit_msgs/action/MoveGroup"}

NEEDS = [
    (Role.VIEW, "subscribe", {"topic": "/joint_states"}),
    (Role.VIEW, "call_service", {"service": "/rosapi/topics"}),
    (Role.VIEW, "call_service", {"service": "/compute_ik"}),
    (Role.VIEW, "call_service", {"service": "/armbridge/goal_history"}),
    (Role.VIEW, "call_service", {"service": "/armbridge/goal_record"}),
    (Role.VIEW, "call_service", {"service": "/arm/stop"}),
    (Role.VIEW, "call_service", {"service": "arm/emergency_stop"}),
    (Role.VIEW, "call_service", {"service": "/servo_node/stop_servo"}),
    (Role.VIEW, "call_service", {"service": "/move_action/_action/cancel_goal"}),
    (Role.VIEW, "publish", {"topic": "/stop"}),
    (Role.VIEW, "publish", {"topic": "stop"}),
    (Role.VIEW, "advertise", {"topic": "/emergency_stop", "type": "std_msgs/Empty"}),
    (Role.VIEW, "advertise", {"topic": "emergency_stop", "type": "std_msgs/Empty"}),
    (Role.VIEW, "cancel_action_goal", {"action": "/move_action"}),
    (Role.OPERATE, "publish", GOAL),
    (Role.OPERATE, "publish", {"topic": "moveit_goal_named"}),
    (Role.OPERATE, "publish", {"topic": "/move_group/goal"}),
    (Role.OPERATE, "publish", {"topic": "/of_a_client"}),
    (Role.OPERATE, "advertise", {"topic": "/moveit_goal_named", "type": "std_msgs/String"}),
    (Role.OPERATE, "advertise_service", {"service": "/mine", "type": "std_srvs/SetBool"}),
    (Role.OPERATE, "advertise_action", {"action": "/mine", "type": "control_msgs/PointHead"}),
    (Role.OPERATE, "send_action_goal", ACTION),
    (Role.OPERATE, "call_service", {"service": "/arm/relax"}),
    (Role.OPERATE, "call_service", {"service": "/arm/park"}),
    (Role.OPERATE, "call_service", {"service": "/arm/take_control"}),
    (Role.OPERATE, "call_service", {"service": "/arm/release_control"}),
    (Role.OPERATE, "call_service", {"service": "/arm/set_speed_limit"}),
    (Role.OPERATE, "call_service", {"service": "/dataset/start_episode"}),
    (Role.OPERATE, "publish", {"topic": "/dataset/episode"}),
    (Role.OPERATE, "call_service", {"service": "/apply_planning_scene"}),
    (Role.OPERATE, "call_service", {"service": "/of_a_client"}),
    (Role.ADMIN, "call_service", {"service": "/rosapi/set_param"}),
    (Role.ADMIN, "call_service", {"service": "/set_planner_params"}),
    (Role.ADMIN, "call_service", {"service": "/save_robot_state"}),
    (Role.ADMIN, "call_service", {"service": "/armbridge/set_logger_levels"}),
    (Role.ADMIN, "call_service", {"service": "/arm/commissioning/begin"}),
    (Role.ADMIN, "call_service", {"service": "/arm/commissioning/answer"}),
    (Role.ADMIN, "call_service", {"service": "/arm/commissioning/cancel"}),
    # The id that a client hangs on the name is no way past the table.
    (Role.ADMIN, "call_service", {"service": "/rosapi/set_param#1"}),
    (Role.ADMIN, "call_service", {"service": "rosapi/set_param#/arm/stop"}),
]


@pytest.mark.parametrize(("least", "op", "fields"), NEEDS, ids=lambda value: str(value))
def test_an_operation_needs_its_role(least: Role, op: str, fields: dict[str, Any]) -> None:
    for identity in (SCREEN, OTTO, ADA):
        refusal = asked(World().authorizer(identity), op, **fields)
        assert (refusal is None) is (identity.role >= least), refusal


def test_a_refusal_names_the_needed_role_the_present_one_and_the_remedy() -> None:
    refusal = asked(World().authorizer(SCREEN), "publish", **GOAL)
    assert refusal == (
        "topic /moveit_goal_named: needs the role operate, this client has view; show a token of "
        "access.operate_tokens or access.admin_tokens"
    )


def test_a_role_that_changes_counts_from_then_on_and_nobody_may_do_nothing() -> None:
    world = World()
    assert asked(world.authorizer(None), "call_service", service="/arm/stop") is not None
    authorizer = world.authorizer(OTTO)
    assert asked(authorizer, "publish", topic="/a") is None
    assert asked(authorizer, "publish", **GOAL) is None
    authorizer.authenticate(SCREEN)
    assert asked(authorizer, "publish", topic="/a") is not None
    assert world.access.lease.holder is None


@pytest.mark.parametrize("topic", ["/a", "/moveit_goal_named"])
def test_a_refused_operation_is_refused_again(topic: str) -> None:
    authorizer = World().authorizer(SCREEN)
    for _ in range(3):
        assert asked(authorizer, "publish", topic=topic) is not None


class TestStopsThatStopNothing:
    """Names that would stop the arm, of topics and services that are not there."""

    FOLLOW = "/any_controller/follow_joint_trajectory"

    @pytest.mark.parametrize(
        "topic", ["/moveit_goal_cancel", f"{FOLLOW}/cancel", "/sequence_move_group/cancel", "/move_action/cancel"]
    )
    def test_a_viewer_makes_no_topics_by_them(self, topic: str) -> None:
        authorizer = World().authorizer(SCREEN)
        for op in ("advertise", "publish"):
            refusal = asked(authorizer, op, topic=topic, type="std_msgs/String")
            assert f"topic {topic}: needs the role operate" in str(refusal)

    def test_the_cancel_topic_of_an_action_of_a_client_is_open_with_its_type_alone(self) -> None:
        for type_name, is_open in (("actionlib_msgs/GoalID", True), ("std_msgs/String", False)):
            world, provider = World(), Node("provider", remote=True)
            authorizer = world.authorizer(SCREEN)
            world.graph.advertise(provider, f"{self.FOLLOW}/cancel", type_name)
            assert asked(authorizer, "publish", topic=f"{self.FOLLOW}/cancel") is not None
            world.graph.actions.offer(
                provider, self.FOLLOW, "control_msgs/action/FollowJointTrajectory", lambda _goal: None
            )
            assert (asked(authorizer, "publish", topic=f"{self.FOLLOW}/cancel") is None) is is_open
            world.graph.remove(provider)
            assert asked(authorizer, "publish", topic=f"{self.FOLLOW}/cancel") is not None

    def test_a_topic_that_only_a_client_listens_to_stops_nothing(self) -> None:
        world = World()
        client = Node("client", remote=True)
        world.graph.subscribe(client, "/moveit_goal_cancel", "std_msgs/Empty", Subscriber(lambda _published: None))
        assert asked(world.authorizer(SCREEN), "publish", topic="/moveit_goal_cancel") is not None

    def test_the_cancel_service_of_no_action_needs_the_role_of_any_other_service(self) -> None:
        world = World()
        service = "/mine/_action/cancel_goal"
        assert "needs the role operate" in str(asked(world.authorizer(SCREEN), "call_service", service=service))
        assert asked(world.authorizer(OTTO), "call_service", service=service) is None


class TestControl:
    def test_while_one_drives_others_may_not(self) -> None:
        world = World()
        first, second = world.authorizer(name="first"), world.authorizer(name="second")
        assert asked(first, "publish", **GOAL) is None
        ways: list[tuple[str, dict[str, Any]]] = [
            ("publish", GOAL),
            ("publish", {"topic": "moveit_goal_named"}),
            ("publish", {"topic": "/move_group/goal", "msg": {"goal": {}}}),
            ("publish", {"topic": "/servo_node/delta_twist_cmds"}),
            ("publish", {"topic": "/arm_controller/joint_trajectory"}),
            ("send_action_goal", ACTION),
            ("call_service", {"service": "/arm/enable"}),
            ("call_service", {"service": "arm/relax#7"}),
        ]
        for op, fields in ways:
            assert "first has controlled the arm since" in str(asked(second, op, **fields)), (op, fields)

    @pytest.mark.parametrize(
        ("op", "fields"),
        [
            ("publish", {"topic": "/stop"}),
            ("publish", {"topic": "/emergency_stop"}),
            ("publish", {"topic": "/move_group/cancel"}),
            ("call_service", {"service": "/arm/stop"}),
            ("call_service", {"service": "/arm/emergency_stop"}),
            ("call_service", {"service": "/arm/pause"}),
            ("call_service", {"service": "/execute_trajectory/_action/cancel_goal"}),
            ("call_service", {"service": "/plan_kinematic_path"}),
            ("call_service", {"service": "/arm/set_speed_limit"}),
            ("publish", {"topic": "/planning_scene"}),
            ("publish", {"topic": "/moveit_goal_confirm"}),
            ("send_action_goal", {**ACTION, "args": {"planning_options": {"plan_only": True}}}),
            ("call_service", {"service": "/moveit_goal", "args": {"named": "home", "plan_only": True}}),
            ("publish", {"topic": "/move_group/goal", "msg": {"goal": {"planning_options": {"plan_only": True}}}}),
        ],
    )
    def test_stops_plans_and_scenes_need_no_control_and_take_none(self, op: str, fields: dict[str, Any]) -> None:
        world = World()
        first, second = world.authorizer(name="first"), world.authorizer(name="second")
        assert asked(first, "publish", **GOAL) is None
        holder = world.access.lease.holder
        assert asked(second, op, **fields) is None
        assert world.access.lease.holder is holder

    def test_options_of_a_plan_do_not_make_a_motion_one(self) -> None:
        world = World()
        asked(world.authorizer(name="first"), "publish", **GOAL)
        args = {"planning_options": {"plan_only": True}}
        action = {"action": "/execute_trajectory", "action_type": "moveit_msgs/action/ExecuteTrajectory", "args": args}
        assert asked(world.authorizer(name="second"), "send_action_goal", **action) is not None

    def test_a_refused_operation_takes_no_control(self) -> None:
        world = World(topics_glob=["/joint_states"])
        asked(world.authorizer(), "publish", **GOAL)
        assert world.access.lease.holder is None


class TestGlobs:
    @pytest.mark.parametrize("op", ["publish", "subscribe", "advertise"])
    @pytest.mark.parametrize("topic", ["/joint_states", "joint_states", "//open/a", "/Open/a", "/x/open/a"])
    def test_other_topics_are_refused_in_every_spelling(self, op: str, topic: str) -> None:
        refusal = asked(World(topics_glob=["/open/*"]).authorizer(), op, topic=topic, type="std_msgs/String")
        assert "fits no pattern of access.topics_glob; add one there" in str(refusal)

    def test_one_that_was_let_through_under_one_spelling_opens_no_other(self) -> None:
        authorizer = World(topics_glob=["/open/*"]).authorizer()
        for op in ("publish", "subscribe", "advertise"):
            assert asked(authorizer, op, topic="open/a", type="std_msgs/String") is None
            assert asked(authorizer, op, topic="/open/a", type="std_msgs/String") is None
        assert asked(authorizer, "publish", topic="/open/a/../../stop2") is None
        assert asked(authorizer, "publish", topic="//open/a") is not None

    def test_services_and_actions_have_theirs_and_rosapi_is_always_open(self) -> None:
        authorizer = World(services_glob=["/compute_*"]).authorizer()
        assert asked(authorizer, "call_service", service="/compute_ik") is None
        assert asked(authorizer, "call_service", service="/rosapi/topics") is None
        assert "access.services_glob" in str(asked(authorizer, "call_service", service="/arm/enable"))
        assert "access.services_glob" in str(asked(authorizer, "call_service", service="/arm/enable#/compute_ik"))
        assert "access.services_glob" in str(asked(authorizer, "send_action_goal", **ACTION))
        assert "access.services_glob" in str(
            asked(authorizer, "advertise_service", service="/mine", type="std_srvs/SetBool")
        )

    def test_the_topics_of_an_action_are_no_way_past_its_glob(self) -> None:
        authorizer = World(services_glob=["/compute_*"]).authorizer()
        assert "action /move_group" in str(asked(authorizer, "publish", topic="/move_group/goal"))

    def test_stops_are_open_whatever_the_globs_say(self) -> None:
        authorizer = World(topics_glob=["/none"], services_glob=["/none"]).authorizer(SCREEN)
        assert asked(authorizer, "publish", topic="/stop") is None
        assert asked(authorizer, "advertise", topic="/emergency_stop", type="std_msgs/Empty") is None
        assert asked(authorizer, "call_service", service="/arm/emergency_stop") is None
        assert asked(authorizer, "call_service", service="/move_action/_action/cancel_goal") is None


class TestRates:
    def test_goals_beyond_the_rate_are_refused_with_limit_and_setting(self) -> None:
        world = World(goals_per_s=2.0, goal_burst=3)
        authorizer = world.authorizer()
        for _ in range(3):
            assert asked(authorizer, "publish", **GOAL) is None
        assert asked(authorizer, "send_action_goal", **ACTION) == (
            "/move_action: this client sends more than 3 goals at once (access.goal_burst) and 2 a second "
            "(access.goals_per_s)"
        )
        world.now_s = 0.5
        assert asked(authorizer, "publish", **GOAL) is None

    def test_another_clients_goals_and_commands_that_steer_are_not_counted(self) -> None:
        world = World(goal_burst=1, control="shared")
        authorizer = world.authorizer()
        for _ in range(10):
            assert asked(authorizer, "publish", topic="/servo_node/delta_twist_cmds") is None
        assert asked(authorizer, "publish", **GOAL) is None
        assert asked(world.authorizer(), "publish", **GOAL) is None

    def test_plans_count_as_the_goals_they_are(self) -> None:
        authorizer = World(goal_burst=1).authorizer()
        planned = {**ACTION, "args": {"planning_options": {"plan_only": True}}}
        assert asked(authorizer, "send_action_goal", **planned) is None
        assert asked(authorizer, "send_action_goal", **planned) is not None


def test_a_client_that_uses_many_topics_takes_no_more_memory_for_it() -> None:
    authorizer = World().authorizer()
    for number in range(2 * MAX_SETTLED):
        assert asked(authorizer, "publish", topic=f"/t{number}") is None
    assert len(authorizer._settled) == MAX_SETTLED


TOKEN = "one-0123456789abcdef"


def access_of(**settings: Any) -> Access:
    values = {"operate_tokens": {"otto": TOKEN}, **settings}
    return Access(AccessSettings.model_validate(values), lambda: 0.0, lambda: 1000.0)


def test_an_auth_without_a_token_names_the_missing_field() -> None:
    assert "wanted the field token" in str(access_of().identify(Auth()))


def test_without_limits_all_drive_at_once() -> None:
    everything = unlimited()
    for name in ("first", "second"):
        authorizer = Authorizer(Node(name, remote=True), everything, SERVER)
        assert authorizer.publishing("/moveit_goal_named", {}) is None


async def test_every_service_and_action_of_the_server_stands_in_the_table_and_no_other(client: ArmClient) -> None:
    offered = set((await client.call("/rosapi/services"))["services"])
    cancelling = {name for name in offered if name.endswith(authorization.CANCEL_SERVICE)}
    assert offered - cancelling == set(SERVER.services.rules)
    offered = (await client.call("/rosapi/action_servers"))["action_servers"]
    assert set(offered) == set(SERVER.actions.rules)
    assert [name for name in offered if not authorization.rule_of_action(name, SERVER).drives] == [description.ACTION]


async def test_every_topic_that_the_server_listens_to_has_a_rule(client: ArmClient) -> None:
    nodes = (await client.call("/rosapi/nodes"))["nodes"]
    heard: set[str] = set()
    for node in nodes:
        if not node.startswith("/client_"):
            heard |= set((await client.call("/rosapi/node_details", node=node))["subscribing"])
    assert set(SERVER.rules) <= heard
    assert [name for name in heard - set(SERVER.rules) if authorization.rule_of_topic(name, SERVER) is WORKING] == []


STOPPING_TOPICS = (
    "/stop",
    "/emergency_stop",
    "/trajectory_execution_event",
    "/moveit_goal_cancel",
    "/move_group/cancel",
    "/arm_controller/follow_joint_trajectory/cancel",
)

MOVING_TOPICS = (
    "/moveit_goal_named",
    "/move_group/goal",
    "/gripper_controller/gripper_cmd/goal",
    "/arm_controller/joint_trajectory",
    "/arm_controller/follow_joint_trajectory/goal",
    "/servo_node/delta_twist_cmds",
    "/arm/speed_factor",
)


def test_topics_that_stop_the_arm_are_open_to_viewers_and_those_that_move_it_need_control() -> None:
    rules = {name: authorization.rule_of_topic(name, SERVER) for name in STOPPING_TOPICS + MOVING_TOPICS}
    assert {name for name, rule in rules.items() if rule.stops and rule.role is Role.VIEW} == set(STOPPING_TOPICS)
    assert {name for name, rule in rules.items() if rule.drives and rule.role is Role.OPERATE} == set(MOVING_TOPICS)


def test_names_that_look_like_a_stop_are_none() -> None:
    for name in ("//stop", "/stop/", "/Stop", "/x/stop", "/mine/cancel", "/emergency_stop "):
        assert not authorization.rule_of_topic(name, SERVER).stops, name


IN_OPTIONS, IN_CALL = permissions.PLANNING_GOAL, permissions.CALLED_GOAL


@pytest.mark.parametrize(
    ("rule", "goal", "planned_only"),
    [
        (IN_OPTIONS, {"planning_options": {"plan_only": True}}, True),
        (IN_OPTIONS, {"planning_options": {"plan_only": 1}}, False),
        (IN_OPTIONS, {"planning_options": {"plan_only": False}}, False),
        (IN_OPTIONS, {"planning_options": [True]}, False),
        (IN_OPTIONS, {"plan_only": True}, False),
        (IN_OPTIONS, [{}, {"plan_only": True}], False),
        (IN_OPTIONS, None, False),
        (IN_CALL, {"plan_only": True}, True),
        (IN_CALL, {"plan_only": 1}, False),
        (IN_CALL, {"planning_options": {"plan_only": True}}, False),
        (IN_CALL, ["home", {}, {}, "", 0.0, 0.0, True], False),
        (IN_CALL, None, False),
    ],
)
def test_a_goal_may_only_ask_for_a_plan(rule: permissions.Rule, goal: object, planned_only: bool) -> None:
    assert authorization.plans_only(rule, goal) is planned_only


AT_ONCE = (
    Publish(topic="/stop"),
    Publish(topic="stop"),
    Publish(topic="/emergency_stop"),
    Publish(topic="/trajectory_execution_event", msg={"data": "stop"}),
    CallService(service="/arm/stop#7"),
    CallService(service="/arm/emergency_stop"),
    CallService(service="/servo_node/stop_servo"),
)

IN_TURN = (
    Publish(topic="/trajectory_execution_event", msg={"data": "go"}),
    Publish(topic="/trajectory_execution_event"),
    Publish(topic="/moveit_goal_cancel"),
    Publish(topic="/move_group/cancel"),
    CallService(service="/move_action/_action/cancel_goal"),
    CallService(service="/arm/pause"),
    SendActionGoal(action="/stop", action_type="std_msgs/Empty"),
)


def test_what_stops_the_arm_goes_ahead_of_everything_that_waits_and_what_ends_single_goals_does_not() -> None:
    assert [operation for operation in AT_ONCE + IN_TURN if authorization.is_stop(operation, SERVER)] == list(AT_ONCE)


def test_services_that_plan_are_known() -> None:
    planning = ["/check_goals", "/compute_ik", "/plan_kinematic_path"]
    assert [
        name for name in (*planning, "/compute_fk") if authorization.rule_of_service(name, SERVER).plans
    ] == planning


ENABLE = {"service": "/arm/enable"}

ENABLE_LEFT, ENABLE_RIGHT = {"service": "/left/arm/enable"}, {"service": "/right/arm/enable"}


class TestSeveralArms:
    """What stands below the name of one of several arms has the rules of a single arm, and its own control."""

    @pytest.fixture
    def world(self) -> World:
        return World(arms=("left", "right"))

    def test_two_clients_drive_an_arm_each(self, world: World) -> None:
        a, b = world.authorizer(name="a"), world.authorizer(name="b")
        assert asked(a, "call_service", **ENABLE_LEFT) is None
        assert asked(b, "call_service", **ENABLE_RIGHT) is None
        refusal = asked(b, "call_service", **ENABLE_LEFT)
        assert refusal is not None
        assert "a has controlled the arm left" in refusal

    def test_nobody_drives_all_arms_while_another_drives_one(self, world: World) -> None:
        a, b = world.authorizer(name="a"), world.authorizer(name="b")
        assert asked(a, "call_service", **ENABLE_LEFT) is None
        assert "the arm left" in (asked(b, "call_service", **ENABLE) or "")
        assert asked(a, "call_service", **ENABLE) is None
        assert "all arms" in (asked(b, "call_service", **ENABLE_RIGHT) or "")

    def test_a_client_that_leaves_frees_every_arm(self, world: World) -> None:
        a, b = world.authorizer(name="a"), world.authorizer(name="b")
        for service in (ENABLE_LEFT, ENABLE_RIGHT, ENABLE):
            assert asked(a, "call_service", **service) is None
        a.leave()
        assert asked(b, "call_service", **ENABLE) is None

    def test_a_viewer_may_stop_an_arm_by_its_name_and_not_move_it(self, world: World) -> None:
        for service in ("/left/arm/stop", "/right/arm/emergency_stop"):
            assert asked(world.authorizer(SCREEN), "call_service", service=service) is None
        for fields in ({"topic": "/left/moveit_goal_named"}, {"topic": "/left/servo_node/delta_twist_cmds"}):
            assert "needs the role operate" in (asked(world.authorizer(SCREEN), "publish", **fields) or "")

    @pytest.mark.parametrize(
        "name", ["/left/stop", "/left/emergency_stop", "/right/arm/stop", "/right/trajectory_execution_event"]
    )
    def test_a_stop_of_one_arm_goes_ahead_of_everything_that_waits(self, name: str) -> None:
        operation = (
            {"op": "call_service", "service": name}
            if "/arm/" in name
            else {"op": "publish", "topic": name, "msg": {"data": "stop"}}
        )
        assert authorization.is_stop(parse(operation), SEVERAL)
        assert not authorization.is_stop(parse(operation), SERVER)

    @pytest.mark.parametrize(
        "name", ["/left/arm/scenes/list", "/left/set_planner_params", "/left/left/stop", "/middle/stop"]
    )
    def test_other_names_below_an_arms_are_those_of_clients(self, name: str) -> None:
        assert authorization.rule_of_service(name, SEVERAL) == WORKING


# Names of services, topics and actions with the rules of the server.
# Those of controllers have the names of the arm's groups.
RULES = {name: rule for rules in server_rules() for name, rule in rules.items() if "_controller/" not in name}

SECURITY = (ROOT / "docs" / "security.md").read_text()


def named_in(pattern: str) -> set[str]:
    """The names that a part of docs/security.md gives; the part is a group of the pattern."""
    found = re.search(pattern, SECURITY, re.DOTALL)
    assert found is not None, pattern
    return set(re.findall(r"`(/[\w/]+\w)`", found[1]))


def test_the_page_of_security_names_what_viewers_may_stop_and_what_needs_an_administrator() -> None:
    # The suffix stands for the cancels of all actions.
    stops = named_in(r"\n(\| \*view\* .*?)\n") - {authorization.CANCEL_SERVICE}
    assert stops == {name for name, rule in RULES.items() if rule.stops}
    configuring = named_in(r"\n(\| \*admin\* .*?)\n")
    assert configuring == {name for name, rule in RULES.items() if rule.role is Role.ADMIN}


def test_the_page_of_security_names_what_needs_the_control_lease_besides_goals_and_steering() -> None:
    leased = named_in(r"refuses these requests of other clients: (.*?)\. The sentence")
    driving = {name for name, rule in RULES.items() if rule.drives and not rule.goal}
    assert leased == {name for name in driving if not name.startswith("/servo_node/")}


def test_patterns_are_those_of_a_shell() -> None:
    names = NameFilter("access.topics_glob", ["/arm[12]/*", "/joint?"])
    for name, fits in {"/arm1/a/b": True, "/arm3/a": False, "/joint1": True, "/joint12": False}.items():
        assert (names.refusal("topic", name) is None) is fits
