from __future__ import annotations

from typing import Any

import pytest

from protocol.operations import parse
from server.access.access import Access
from server.access.guard import MAX_SETTLED, Guard
from server.access.roles import ANYONE, Identity, Role
from server.access.settings import AccessSettings
from server.graph.node import Node

SCREEN, OTTO, ADA = Identity("screen", Role.VIEW), Identity("otto", Role.OPERATE), Identity("ada", Role.ADMIN)


class World:
    """Clients before one server's guards, in a time of their own."""

    def __init__(self, **settings: Any) -> None:
        self.now_s = 0.0
        self.access = Access(AccessSettings.model_validate(settings), lambda: self.now_s, lambda: 0.0)

    def guard(self, identity: Identity | None = ANYONE, name: str = "x") -> Guard:
        return self.access.guard(Node(name, remote=True, identity=identity))


def asked(guard: Guard, op: str, **fields: Any) -> str | None:
    return guard.refusal(parse({"op": op, **fields}))


GOAL = {"topic": "/moveit_goal_named", "msg": {"data": "home"}}
ACTION = {"action": "/move_action", "action_type": "moveit_msgs/action/MoveGroup"}

NEEDS = [
    (Role.VIEW, "subscribe", {"topic": "/joint_states"}),
    (Role.VIEW, "call_service", {"service": "/rosapi/topics"}),
    (Role.VIEW, "call_service", {"service": "/compute_ik"}),
    (Role.VIEW, "call_service", {"service": "/arm/stop"}),
    (Role.VIEW, "call_service", {"service": "arm/emergency_stop"}),
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
    (Role.OPERATE, "call_service", {"service": "/apply_planning_scene"}),
    (Role.OPERATE, "call_service", {"service": "/of_a_client"}),
    (Role.ADMIN, "call_service", {"service": "/rosapi/set_param"}),
    (Role.ADMIN, "call_service", {"service": "/set_planner_params"}),
    (Role.ADMIN, "call_service", {"service": "/save_robot_state"}),
    (Role.ADMIN, "call_service", {"service": "/armbridge/set_logger_levels"}),
    # The id that a client hangs on the name is no way past the table.
    (Role.ADMIN, "call_service", {"service": "/rosapi/set_param#1"}),
    (Role.ADMIN, "call_service", {"service": "rosapi/set_param#/arm/stop"}),
]


@pytest.mark.parametrize(("least", "op", "fields"), NEEDS, ids=lambda value: str(value))
def test_an_operation_needs_its_role(least: Role, op: str, fields: dict[str, Any]) -> None:
    for identity in (SCREEN, OTTO, ADA):
        refusal = asked(World().guard(identity), op, **fields)
        assert (refusal is None) is (identity.role >= least), refusal


def test_a_refusal_names_what_is_needed_what_is_there_and_what_to_show() -> None:
    refusal = asked(World().guard(SCREEN), "publish", **GOAL)
    assert refusal == (
        "topic /moveit_goal_named: needs the role operate, this client has view; show a token of "
        "access.operate_tokens or access.admin_tokens"
    )


def test_a_client_that_is_nobody_may_do_nothing() -> None:
    assert asked(World().guard(None), "call_service", service="/arm/stop") is not None


def test_a_role_that_changes_counts_from_then_on() -> None:
    world = World()
    guard = world.guard(OTTO)
    assert asked(guard, "publish", topic="/a") is None
    assert asked(guard, "publish", **GOAL) is None
    guard.become(SCREEN)
    assert asked(guard, "publish", topic="/a") is not None
    assert world.access.lease.holder is None


@pytest.mark.parametrize("topic", ["/a", "/moveit_goal_named"])
def test_what_was_refused_once_is_refused_again(topic: str) -> None:
    guard = World().guard(SCREEN)
    for _ in range(3):
        assert asked(guard, "publish", topic=topic) is not None


class TestControl:
    def test_while_one_drives_others_may_not(self) -> None:
        world = World()
        first, second = world.guard(name="first"), world.guard(name="second")
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
            ("publish", {"topic": "/planning_scene"}),
            ("publish", {"topic": "/moveit_goal_confirm"}),
            ("send_action_goal", {**ACTION, "args": {"planning_options": {"plan_only": True}}}),
            ("publish", {"topic": "/move_group/goal", "msg": {"goal": {"planning_options": {"plan_only": True}}}}),
        ],
    )
    def test_stops_plans_and_scenes_need_no_control_and_take_none(self, op: str, fields: dict[str, Any]) -> None:
        world = World()
        first, second = world.guard(name="first"), world.guard(name="second")
        assert asked(first, "publish", **GOAL) is None
        holder = world.access.lease.holder
        assert asked(second, op, **fields) is None
        assert world.access.lease.holder is holder

    def test_options_of_a_plan_do_not_make_a_motion_one(self) -> None:
        world = World()
        asked(world.guard(name="first"), "publish", **GOAL)
        args = {"planning_options": {"plan_only": True}}
        action = {"action": "/execute_trajectory", "action_type": "moveit_msgs/action/ExecuteTrajectory", "args": args}
        assert asked(world.guard(name="second"), "send_action_goal", **action) is not None

    def test_a_client_that_leaves_frees_it(self) -> None:
        world = World()
        first, second = world.guard(name="first"), world.guard(name="second")
        asked(first, "publish", **GOAL)
        first.leave()
        assert asked(second, "publish", **GOAL) is None

    def test_what_is_refused_takes_no_control(self) -> None:
        world = World(topics_glob=["/joint_states"])
        asked(world.guard(), "publish", **GOAL)
        assert world.access.lease.holder is None


class TestGlobs:
    @pytest.mark.parametrize("topic", ["/open/a", "open/a"])
    def test_topics_that_fit_are_open(self, topic: str) -> None:
        guard = World(topics_glob=["/open/*"]).guard()
        for op in ("publish", "subscribe", "advertise"):
            assert asked(guard, op, topic=topic, type="std_msgs/String") is None

    @pytest.mark.parametrize("op", ["publish", "subscribe", "advertise"])
    @pytest.mark.parametrize("topic", ["/joint_states", "joint_states", "//open/a", "/Open/a", "/x/open/a"])
    def test_others_are_not_however_they_are_written(self, op: str, topic: str) -> None:
        refusal = asked(World(topics_glob=["/open/*"]).guard(), op, topic=topic, type="std_msgs/String")
        assert "fits no pattern of access.topics_glob; add one there" in str(refusal)

    def test_one_that_was_let_through_under_one_spelling_opens_no_other(self) -> None:
        guard = World(topics_glob=["/open/*"]).guard()
        assert asked(guard, "publish", topic="/open/a") is None
        assert asked(guard, "publish", topic="/open/a/../../stop2") is None
        assert asked(guard, "publish", topic="//open/a") is not None

    def test_services_and_actions_have_theirs_and_rosapi_is_always_open(self) -> None:
        guard = World(services_glob=["/compute_*"]).guard()
        assert asked(guard, "call_service", service="/compute_ik") is None
        assert asked(guard, "call_service", service="/rosapi/topics") is None
        assert "access.services_glob" in str(asked(guard, "call_service", service="/arm/enable"))
        assert "access.services_glob" in str(asked(guard, "call_service", service="/arm/enable#/compute_ik"))
        assert "access.services_glob" in str(asked(guard, "send_action_goal", **ACTION))
        assert "access.services_glob" in str(
            asked(guard, "advertise_service", service="/mine", type="std_srvs/SetBool")
        )

    def test_the_topics_of_an_action_are_no_way_past_its_glob(self) -> None:
        guard = World(services_glob=["/compute_*"]).guard()
        assert "action /move_group" in str(asked(guard, "publish", topic="/move_group/goal"))

    def test_stops_are_open_whatever_the_globs_say(self) -> None:
        guard = World(topics_glob=["/none"], services_glob=["/none"]).guard(SCREEN)
        assert asked(guard, "publish", topic="/stop") is None
        assert asked(guard, "advertise", topic="/emergency_stop", type="std_msgs/Empty") is None
        assert asked(guard, "call_service", service="/arm/emergency_stop") is None
        assert asked(guard, "call_service", service="/move_action/_action/cancel_goal") is None


class TestRates:
    def test_goals_beyond_the_rate_are_refused_with_limit_and_setting(self) -> None:
        world = World(goals_per_s=2.0, goal_burst=3)
        guard = world.guard()
        for _ in range(3):
            assert asked(guard, "publish", **GOAL) is None
        assert asked(guard, "send_action_goal", **ACTION) == (
            "/move_action: this client sends more than 3 goals at once (access.goal_burst) and 2 a second "
            "(access.goals_per_s)"
        )
        world.now_s = 0.5
        assert asked(guard, "publish", **GOAL) is None

    def test_another_clients_goals_are_not_counted(self) -> None:
        world = World(goal_burst=1, control="shared")
        assert asked(world.guard(), "publish", **GOAL) is None
        assert asked(world.guard(), "publish", **GOAL) is None

    def test_commands_that_steer_are_no_goals(self) -> None:
        guard = World(goal_burst=1).guard()
        for _ in range(10):
            assert asked(guard, "publish", topic="/servo_node/delta_twist_cmds") is None

    def test_plans_count_as_the_goals_they_are(self) -> None:
        guard = World(goal_burst=1).guard()
        planned = {**ACTION, "args": {"planning_options": {"plan_only": True}}}
        assert asked(guard, "send_action_goal", **planned) is None
        assert asked(guard, "send_action_goal", **planned) is not None


def test_a_client_that_uses_many_topics_takes_no_more_memory_for_it() -> None:
    guard = World().guard()
    for number in range(2 * MAX_SETTLED):
        assert asked(guard, "publish", topic=f"/t{number}") is None
    assert len(guard._settled) == MAX_SETTLED
