import re
from collections.abc import Sequence
from typing import Any

import pytest

from harness.clients import ArmClient
from harness.server import ROOT
from protocol.operations import CallService, Operation, Publish, SendActionGoal, parse
from server.access import authorization
from server.access.authorization import MAX_SETTLED, Access, Authorizer, unlimited
from server.access.settings import AccessSettings
from server.graph import permissions
from server.graph.permissions import ANYONE, WORKING, Identity, NameFilter, Node, Role
from server.graph.topics import Graph, Subscriber
from server.moveit.services import description
from tests.helpers.clock import FakeClock
from tests.helpers.messages import REGISTRY
from tests.helpers.rules import server_rules, with_server_rules

SCREEN, AGENT, OTTO, ADA = (Identity(role.name, role) for role in Role)

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


# The field that names what an operation is about, and the further ones that it needs.
NAMED: dict[str, tuple[str, dict[str, str]]] = {
    "publish": ("topic", {}),
    "subscribe": ("topic", {}),
    "advertise": ("topic", {"type": "std_msgs/Empty"}),
    "call_service": ("service", {}),
    "advertise_service": ("service", {"type": "std_srvs/SetBool"}),
    "send_action_goal": ("action", {"action_type": "moveit_msgs/action/MoveGroup"}),
    "cancel_action_goal": ("action", {}),
    "advertise_action": ("action", {"type": "control_msgs/PointHead"}),
}


def asked(authorizer: Authorizer, op: str, name: str, **fields: Any) -> str | None:
    field, needed = NAMED[op]
    return authorizer.refusal(parse({"op": op, field: name, **needed, **fields}))


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


GOAL, ACTION = "/moveit_goal_named", "/move_action"
PLAN_ONLY = {"planning_options": {"plan_only": True}}

NEEDS: dict[Role, dict[str, str]] = {
    Role.VIEW: {
        "subscribe": "/joint_states",
        "call_service": "/rosapi/topics /compute_ik /armbridge/goal_history /armbridge/goal_record /arm/stop "
        "arm/emergency_stop /servo_node/stop_servo /move_action/_action/cancel_goal",
        "publish": "/stop stop",
        "advertise": "/emergency_stop emergency_stop",
        "cancel_action_goal": ACTION,
    },
    Role.PROPOSE: {"call_service": "/moveit_goal"},
    Role.OPERATE: {
        "publish": f"{GOAL} moveit_goal_named /move_group/goal /of_a_client /dataset/episode /moveit_goal_approve "
        "/arm/speed_factor /servo_node/delta_joint_cmds",
        "advertise": GOAL,
        "advertise_service": "/mine",
        "advertise_action": "/mine",
        "send_action_goal": ACTION,
        "call_service": "/arm/relax /arm/park /arm/take_control /arm/release_control /arm/set_speed_limit "
        "/dataset/start_episode /apply_planning_scene /of_a_client",
    },
    Role.ADMIN: {
        # The id that a client hangs on the name is no way past the table.
        "call_service": "/rosapi/set_param /rosapi/set_param#1 rosapi/set_param#/arm/stop /set_planner_params "
        "/save_robot_state /armbridge/set_logger_levels /arm/commissioning/begin /arm/commissioning/answer "
        "/arm/commissioning/cancel",
    },
}


@pytest.mark.parametrize(
    ("least", "op", "name"),
    [(least, op, name) for least, ops in NEEDS.items() for op, names in ops.items() for name in names.split()],
)
def test_an_operation_needs_its_role(least: Role, op: str, name: str) -> None:
    for identity in (SCREEN, AGENT, OTTO, ADA):
        refusal = asked(World().authorizer(identity), op, name)
        assert (refusal is None) is (identity.role >= least), refusal


def test_a_refusal_names_the_needed_role_the_present_one_and_the_remedy() -> None:
    assert asked(World().authorizer(SCREEN), "publish", GOAL) == (
        "topic /moveit_goal_named: needs the role operate, this client has view; show a token of "
        "access.operate_tokens or access.admin_tokens"
    )


def test_a_role_that_changes_counts_from_then_on_and_nobody_may_do_nothing() -> None:
    world = World()
    assert asked(world.authorizer(None), "call_service", "/arm/stop") is not None
    authorizer = world.authorizer(OTTO)
    assert asked(authorizer, "publish", "/a") is asked(authorizer, "publish", GOAL) is None
    authorizer.authenticate(ADA)
    assert world.access.lease.holder is not None
    authorizer.authenticate(SCREEN)
    for topic in ("/a", "/a", GOAL, GOAL):
        assert asked(authorizer, "publish", topic) is not None
    assert world.access.lease.holder is None


class TestStopsThatStopNothing:
    """Names that would stop the arm, of topics and services that are not there."""

    FOLLOW = "/any_controller/follow_joint_trajectory"

    def test_a_viewer_makes_no_topics_by_them(self) -> None:
        authorizer = World().authorizer(SCREEN)
        for topic in (
            "/moveit_goal_cancel",
            f"{self.FOLLOW}/cancel",
            "/sequence_move_group/cancel",
            f"{ACTION}/cancel",
        ):
            for op in ("advertise", "publish"):
                refusal = asked(authorizer, op, topic, type="std_msgs/String")
                assert f"topic {topic}: needs the role operate" in str(refusal)

    def test_the_cancel_topic_of_an_action_of_a_client_is_open_with_its_type_alone(self) -> None:
        cancel = f"{self.FOLLOW}/cancel"
        for type_name, is_open in (("actionlib_msgs/GoalID", True), ("std_msgs/String", False)):
            world, provider = World(), Node("provider", remote=True)
            authorizer = world.authorizer(SCREEN)
            world.graph.advertise(provider, cancel, type_name)
            assert asked(authorizer, "publish", cancel) is not None
            world.graph.actions.offer(
                provider, self.FOLLOW, "control_msgs/action/FollowJointTrajectory", lambda _goal: None
            )
            assert (asked(authorizer, "publish", cancel) is None) is is_open
            world.graph.remove(provider)
            assert asked(authorizer, "publish", cancel) is not None

    def test_a_topic_that_only_a_client_listens_to_stops_nothing(self) -> None:
        world, client = World(), Node("client", remote=True)
        world.graph.subscribe(client, "/moveit_goal_cancel", "std_msgs/Empty", Subscriber(lambda _published: None))
        assert asked(world.authorizer(SCREEN), "publish", "/moveit_goal_cancel") is not None

    def test_the_cancel_service_of_no_action_needs_the_role_of_any_other_service(self) -> None:
        world, service = World(), "/mine/_action/cancel_goal"
        assert "needs the role operate" in str(asked(world.authorizer(SCREEN), "call_service", service))
        assert asked(world.authorizer(OTTO), "call_service", service) is None


class TestControl:
    @pytest.fixture
    def world(self) -> World:
        """A server whose arm the client "first" drives."""
        world = World()
        assert asked(world.authorizer(name="first"), "publish", GOAL) is None
        return world

    def test_while_one_drives_others_may_not(self, world: World) -> None:
        second = world.authorizer(name="second")
        # Its goal waits for a client that may drive.
        assert asked(world.authorizer(AGENT, "agent"), "call_service", "/moveit_goal") is None
        steering = "/servo_node/delta_twist_cmds", "/arm_controller/joint_trajectory"
        ways = [("publish", topic) for topic in (GOAL, "moveit_goal_named", "/move_group/goal", *steering)]
        ways += [("send_action_goal", ACTION), ("call_service", "/moveit_goal")]
        ways += [("call_service", "/arm/enable"), ("call_service", "arm/relax#7")]
        for op, name in ways:
            assert "first has controlled the arm since" in str(asked(second, op, name)), (op, name)
        # Options of a plan do not make a motion one.
        assert asked(second, "send_action_goal", "/execute_trajectory", args=PLAN_ONLY) is not None

    def test_stops_plans_and_scenes_need_no_control_and_take_none(self, world: World) -> None:
        second, holder = world.authorizer(name="second"), world.access.lease.holder
        services = "stop emergency_stop pause set_speed_limit"
        free: list[tuple[str, str, dict[str, Any]]] = [
            *(("publish", topic, {}) for topic in (*STOPS, "/planning_scene", "/moveit_goal_approve")),
            *(("call_service", f"/arm/{name}", {}) for name in services.split()),
            ("call_service", "/execute_trajectory/_action/cancel_goal", {}),
            ("call_service", "/plan_kinematic_path", {}),
            ("send_action_goal", ACTION, {"args": PLAN_ONLY}),
            ("call_service", "/moveit_goal", {"args": {"named": "home", "plan_only": True}}),
            ("publish", "/move_group/goal", {"msg": {"goal": PLAN_ONLY}}),
        ]
        for op, name, fields in free:
            assert asked(second, op, name, **fields) is None, name
            assert world.access.lease.holder is holder, name

    def test_a_refused_operation_takes_no_control(self) -> None:
        world = World(topics_glob=["/joint_states"])
        asked(world.authorizer(), "publish", GOAL)
        assert world.access.lease.holder is None


class TestGlobs:
    def test_other_topics_are_refused_in_every_spelling(self) -> None:
        for topic in ("/joint_states", "joint_states", "//open/a", "/Open/a", "/x/open/a"):
            for op in ("publish", "subscribe", "advertise"):
                refusal = asked(World(topics_glob=["/open/*"]).authorizer(), op, topic)
                assert "fits no pattern of access.topics_glob; add one there" in str(refusal), (op, topic)

    def test_one_that_was_let_through_under_one_spelling_opens_no_other(self) -> None:
        authorizer = World(topics_glob=["/open/*"]).authorizer()
        for op in ("publish", "subscribe", "advertise"):
            assert asked(authorizer, op, "open/a") is asked(authorizer, op, "/open/a") is None
        assert asked(authorizer, "publish", "/open/a/../../stop2") is None
        assert asked(authorizer, "publish", "//open/a") is not None

    def test_services_and_actions_have_theirs_and_rosapi_is_always_open(self) -> None:
        authorizer = World(services_glob=["/compute_*"]).authorizer()
        assert asked(authorizer, "call_service", "/compute_ik") is None
        assert asked(authorizer, "call_service", "/rosapi/topics") is None
        for op, name in (
            ("call_service", "/arm/enable"),
            ("call_service", "/arm/enable#/compute_ik"),
            ("send_action_goal", ACTION),
            ("advertise_service", "/mine"),
        ):
            assert "access.services_glob" in str(asked(authorizer, op, name)), name
        # The topics of an action are no way past its filter.
        assert "action /move_group" in str(asked(authorizer, "publish", "/move_group/goal"))

    def test_stops_are_open_whatever_the_globs_say(self) -> None:
        authorizer = World(topics_glob=["/none"], services_glob=["/none"]).authorizer(SCREEN)
        for op, names in {
            "publish": "/stop",
            "advertise": "/emergency_stop",
            "call_service": "/arm/emergency_stop /move_action/_action/cancel_goal",
        }.items():
            assert [asked(authorizer, op, name) for name in names.split() if asked(authorizer, op, name)] == [], op


class TestRates:
    def test_goals_beyond_the_rate_are_refused_with_limit_and_setting(self) -> None:
        world = World(goals_per_s=2.0, goal_burst=3)
        authorizer = world.authorizer()
        # Plans count as the goals they are.
        for op, name, fields in (("publish", GOAL, {}), *[("send_action_goal", ACTION, {"args": PLAN_ONLY})] * 2):
            assert asked(authorizer, op, name, **fields) is None
        assert asked(authorizer, "send_action_goal", ACTION) == (
            "/move_action: this client sends more than 3 goals at once (access.goal_burst) and 2 a second "
            "(access.goals_per_s)"
        )
        world.now_s = 0.5
        assert asked(authorizer, "publish", GOAL) is None

    def test_another_clients_goals_and_commands_that_steer_are_not_counted(self) -> None:
        world = World(goal_burst=1, control="shared")
        authorizer = world.authorizer()
        for _ in range(10):
            assert asked(authorizer, "publish", "/servo_node/delta_twist_cmds") is None
        assert asked(authorizer, "publish", GOAL) is asked(world.authorizer(), "publish", GOAL) is None


def test_a_client_that_uses_many_topics_takes_no_more_memory_for_it() -> None:
    authorizer = World().authorizer()
    for number in range(2 * MAX_SETTLED):
        assert asked(authorizer, "publish", f"/t{number}") is None
    assert len(authorizer.settled) == MAX_SETTLED


def test_without_limits_all_drive_at_once() -> None:
    everything = unlimited()
    for name in ("first", "second"):
        assert Authorizer(Node(name, remote=True), everything, SERVER).publishing(GOAL, {}) is None


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


def test_topics_that_stop_the_arm_are_open_to_viewers_and_those_that_move_it_need_control() -> None:
    follow = "/arm_controller/follow_joint_trajectory"
    stopping = {"/stop", "/emergency_stop", "/trajectory_execution_event", "/moveit_goal_cancel", "/move_group/cancel"}
    stopping |= {f"{follow}/cancel"}
    moving = {GOAL, "/move_group/goal", "/gripper_controller/gripper_cmd/goal", "/arm_controller/joint_trajectory"}
    moving |= {f"{follow}/goal", "/servo_node/delta_twist_cmds", "/arm/speed_factor"}
    rules = {name: authorization.rule_of_topic(name, SERVER) for name in stopping | moving}
    assert {name for name, rule in rules.items() if rule.stops and rule.role is Role.VIEW} == stopping
    assert {name for name, rule in rules.items() if rule.drives and rule.role is Role.OPERATE} == moving


def test_names_that_look_like_a_stop_are_none() -> None:
    for name in ("//stop", "/stop/", "/Stop", "/x/stop", "/mine/cancel", "/emergency_stop "):
        assert not authorization.rule_of_topic(name, SERVER).stops, name


def test_a_goal_may_only_ask_for_a_plan() -> None:
    call = {"plan_only": True}
    of_options: list[Any] = [{"planning_options": {"plan_only": 1}}, {"planning_options": {"plan_only": False}}]
    of_options += [{"planning_options": [True]}, call, [{}, call], None]
    of_call: list[Any] = [{"plan_only": 1}, PLAN_ONLY, ["home", {}, {}, "", 0.0, 0.0, True], None]
    for rule, plan, motions in (
        (permissions.PLANNING_GOAL, PLAN_ONLY, of_options),
        (permissions.CALLED_GOAL, call, of_call),
    ):
        assert authorization.plans_only(rule, plan)
        assert [motion for motion in motions if authorization.plans_only(rule, motion)] == []


EVENT = "/trajectory_execution_event"


def test_what_stops_the_arm_goes_ahead_of_everything_that_waits_and_what_ends_single_goals_does_not() -> None:
    at_once: list[Operation] = [Publish(topic=topic) for topic in ("/stop", "stop", "/emergency_stop")]
    at_once += [Publish(topic=EVENT, msg={"data": "stop"})]
    services = ("/arm/stop#7", "/arm/emergency_stop", "/servo_node/stop_servo")
    at_once += [CallService(service=service) for service in services]
    in_turn: list[Operation] = [Publish(topic=topic) for topic in (EVENT, "/moveit_goal_cancel", "/move_group/cancel")]
    in_turn += [Publish(topic=EVENT, msg={"data": "go"}), SendActionGoal(action="/stop", action_type="std_msgs/Empty")]
    in_turn += [CallService(service=service) for service in ("/move_action/_action/cancel_goal", "/arm/pause")]
    assert [operation for operation in at_once + in_turn if authorization.is_stop(operation, SERVER)] == at_once


def test_services_that_plan_are_known() -> None:
    planning = ["/check_goals", "/compute_ik", "/plan_kinematic_path"]
    rules = {name: authorization.rule_of_service(name, SERVER) for name in (*planning, "/compute_fk")}
    assert [name for name, rule in rules.items() if rule.plans] == planning


ENABLE, ENABLE_LEFT, ENABLE_RIGHT = (f"{prefix}/arm/enable" for prefix in ("", "/left", "/right"))


class TestSeveralArms:
    """What stands below the name of one of several arms has the rules of a single arm, and its own control."""

    @pytest.fixture
    def world(self) -> World:
        return World(arms=("left", "right"))

    @pytest.fixture
    def a(self, world: World) -> Authorizer:
        return world.authorizer(name="a")

    @pytest.fixture
    def b(self, world: World) -> Authorizer:
        return world.authorizer(name="b")

    def test_two_clients_drive_an_arm_each(self, a: Authorizer, b: Authorizer) -> None:
        assert asked(a, "call_service", ENABLE_LEFT) is asked(b, "call_service", ENABLE_RIGHT) is None
        assert "a has controlled the arm left" in str(asked(b, "call_service", ENABLE_LEFT))

    def test_nobody_drives_all_arms_while_another_drives_one(self, a: Authorizer, b: Authorizer) -> None:
        assert asked(a, "call_service", ENABLE_LEFT) is None
        assert "the arm left" in str(asked(b, "call_service", ENABLE))
        assert asked(a, "call_service", ENABLE) is None
        assert "all arms" in str(asked(b, "call_service", ENABLE_RIGHT))

    def test_a_client_that_leaves_frees_every_arm(self, a: Authorizer, b: Authorizer) -> None:
        for service in (ENABLE_LEFT, ENABLE_RIGHT, ENABLE):
            assert asked(a, "call_service", service) is None
        a.leave()
        assert asked(b, "call_service", ENABLE) is None

    def test_a_viewer_may_stop_an_arm_by_its_name_and_not_move_it(self, world: World) -> None:
        screen = world.authorizer(SCREEN)
        for service in ("/left/arm/stop", "/right/arm/emergency_stop"):
            assert asked(screen, "call_service", service) is None
        for topic in ("/left/moveit_goal_named", "/left/servo_node/delta_twist_cmds"):
            assert "needs the role operate" in str(asked(screen, "publish", topic))

    def test_a_stop_of_one_arm_goes_ahead_of_everything_that_waits(self) -> None:
        stop = {"data": "stop"}
        topics = ("/left/stop", "/left/emergency_stop", "/right/trajectory_execution_event")
        for operation in (
            CallService(service="/right/arm/stop"),
            *(Publish(topic=topic, msg=stop) for topic in topics),
        ):
            assert authorization.is_stop(operation, SEVERAL), operation
            assert not authorization.is_stop(operation, SERVER), operation

    def test_other_names_below_an_arms_are_those_of_clients(self) -> None:
        for name in ("/left/arm/scenes/list", "/left/set_planner_params", "/left/left/stop", "/middle/stop"):
            assert authorization.rule_of_service(name, SEVERAL) == WORKING, name


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
