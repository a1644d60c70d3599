"""The table against what a running server offers."""

from __future__ import annotations

import pytest

from server.access import rules
from server.access.roles import Role
from tests.helpers.arm_server import ArmClient


async def test_every_service_of_the_server_stands_in_the_table_and_no_other(client: ArmClient) -> None:
    offered = set((await client.call("/rosapi/services"))["services"])
    cancelling = {name for name in offered if name.endswith(rules.CANCEL_SERVICE)}
    assert offered - cancelling == set(rules.SERVICES)


async def test_every_action_of_the_server_drives(client: ArmClient) -> None:
    offered = (await client.call("/rosapi/action_servers"))["action_servers"]
    assert set(rules.ACTIONS) <= set(offered)
    assert [name for name in offered if not rules.of_action(name).drives] == []


async def test_every_topic_that_the_server_listens_to_has_a_rule(client: ArmClient) -> None:
    nodes = (await client.call("/rosapi/nodes"))["nodes"]
    heard: set[str] = set()
    for node in nodes:
        if not node.startswith("/client_"):
            heard |= set((await client.call("/rosapi/node_details", node=node))["subscribing"])
    assert set(rules.TOPICS) <= heard
    assert [name for name in heard - set(rules.TOPICS) if rules.of_topic(name) is rules.WORKING] == []


@pytest.mark.parametrize(
    "name", ["/arm/stop", "/arm/emergency_stop", "/servo_node/stop_servo", "/move_action/_action/cancel_goal"]
)
def test_services_that_stop_are_open_to_whoever_looks(name: str) -> None:
    assert rules.of_service(name).stops
    assert rules.of_service(name).role is Role.VIEW


@pytest.mark.parametrize(
    "name",
    [
        "/stop",
        "/emergency_stop",
        "/trajectory_execution_event",
        "/moveit_goal_cancel",
        "/move_group/cancel",
        "/arm_controller/follow_joint_trajectory/cancel",
    ],
)
def test_topics_that_stop_are_open_to_whoever_looks(name: str) -> None:
    assert rules.of_topic(name).stops
    assert rules.of_topic(name).role is Role.VIEW


@pytest.mark.parametrize(
    "name",
    [
        "/moveit_goal_named",
        "/move_group/goal",
        "/gripper_controller/gripper_cmd/goal",
        "/arm_controller/joint_trajectory",
        "/arm_controller/follow_joint_trajectory/goal",
        "/servo_node/delta_twist_cmds",
        "/arm/speed_factor",
    ],
)
def test_topics_that_move_the_arm_drive(name: str) -> None:
    assert rules.of_topic(name).drives
    assert rules.of_topic(name).role is Role.OPERATE


def test_what_clients_offer_needs_the_right_to_operate_and_no_control() -> None:
    for rule in (rules.of_service("/mine"), rules.of_action("/mine"), rules.of_topic("/mine/goal")):
        assert rule == rules.WORKING
        assert rule.role is Role.OPERATE
        assert not rule.drives


@pytest.mark.parametrize("name", ["//stop", "/stop/", "/Stop", "/x/stop", "/mine/cancel", "/emergency_stop "])
def test_names_that_look_like_a_stop_are_none(name: str) -> None:
    assert not rules.of_topic(name).stops


@pytest.mark.parametrize(
    ("goal", "planned_only"),
    [
        ({"planning_options": {"plan_only": True}}, True),
        ({"planning_options": {"plan_only": 1}}, False),
        ({"planning_options": {"plan_only": False}}, False),
        ({"planning_options": [True]}, False),
        ({"plan_only": True}, False),
        ([{}, {"plan_only": True}], False),
        (None, False),
    ],
)
def test_a_goal_that_only_asks_for_a_plan_says_so_in_its_options(goal: object, planned_only: bool) -> None:
    assert rules.plans_only(goal) is planned_only
