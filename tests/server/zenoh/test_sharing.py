from __future__ import annotations

import pytest

from server.zenoh.outgoing import OutgoingTopics
from tests.helpers.zenoh_network import RosMachine, Site, free_port, until

STRING = "std_msgs/msg/String"


async def test_a_client_sends_goals_to_another_arm_by_its_name_there() -> None:
    port = free_port()
    async with (
        Site(port, mode="router", namespace="/arm1", subscribe=("/moveit_goal_*",)) as arm,
        Site(to=(port,), mode="client", namespace="/arm2", publish=("/joint_states", "/arm1/moveit_goal_*")) as other,
    ):
        goals = arm.hear("/moveit_goal_named", STRING, arm.part)
        other.graph.advertise(other.part, "/joint_states", STRING)
        with RosMachine(port) as machine:
            await until(lambda: machine.has_token("/MP/%/%arm2/armbridge/%arm2%joint_states"))
            await until(lambda: machine.has_token("/MS/%/%arm1/armbridge/%arm1%moveit_goal_named"))
            other.graph.advertise(other.client, "/arm1/moveit_goal_named", STRING)
            await until(lambda: machine.has_token("/MP/%/%arm2/armbridge/%arm1%moveit_goal_named"))
            other.graph.publish(other.client, "/arm1/moveit_goal_named", {"data": "ready"}, lifespan_s=1.0)
            await until(lambda: goals)
    assert [goal.msg["data"] for goal in goals] == ["ready"]


async def test_a_machine_without_a_namespace_does_not_take_this_arms_out_of_its_own() -> None:
    port = free_port()
    async with Site(port, namespace="/arm1", publish=("/joint_states", "/news")) as site:
        with RosMachine(port) as machine:
            machine.announce_topic("/joint_states", STRING)
            site.graph.advertise(site.client, "/news", STRING)
            await until(lambda: machine.has_token("/MP/%/%arm1/armbridge/%arm1%news/"))
            site.graph.advertise(site.part, "/joint_states", STRING)
            await until(lambda: machine.has_token("/MP/%/%arm1/armbridge/%arm1%joint_states/"))


async def test_one_server_shows_the_arms_of_others_to_its_viewers() -> None:
    first, second = free_port(), free_port()
    async with (
        Site(first, namespace="/arm1", publish=("/joint_states",)) as one,
        Site(second, namespace="/arm2", publish=("/joint_states",)) as two,
        Site(to=(first, second), subscribe=("/arm1/*", "/arm2/*")) as edge,
    ):
        for site in (one, two):
            site.graph.advertise(site.part, "/joint_states", STRING, latch=True)
            site.graph.publish(site.part, "/joint_states", {"data": site.namespace})
        await until(lambda: {"/arm1/joint_states", "/arm2/joint_states"} <= edge.graph.topic_types().keys())
        heard = edge.hear("/arm1/joint_states"), edge.hear("/arm2/joint_states")
        await until(lambda: all(heard))
    assert [messages[0].msg["data"] for messages in heard] == ["/arm1", "/arm2"]


async def test_who_may_send_goals_may_stop_the_arm() -> None:
    port = free_port()
    async with Site(port, subscribe=("/moveit_goal_named",), offer=("/arm/enable",)) as site:
        for topic in ("/moveit_goal_named", "/moveit_goal_joints", "/stop"):
            site.hear(topic, STRING, site.part)
        for service in ("/arm/enable", "/arm/relax", "/arm/stop"):
            site.graph.services.offer(site.part, service, "std_srvs/Trigger", lambda _request: {})
        with RosMachine(port) as machine:
            await until(lambda: machine.has_token("/MS/%/%/armbridge/%stop/"))
            await until(lambda: machine.has_token("/SS/%/%/armbridge/%arm%stop/"))
            assert not machine.has_token("%moveit_goal_joints")
            assert not machine.has_token("%arm%relax")


async def test_what_goes_wrong_once_does_not_end_the_sharing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    port, refresh, failures = free_port(), OutgoingTopics.refresh, iter([True])

    def fail_once(topics: OutgoingTopics, foreign: frozenset[str]) -> None:
        if next(failures, False):
            raise RuntimeError("a bug")
        refresh(topics, foreign)

    monkeypatch.setattr(OutgoingTopics, "refresh", fail_once)
    async with Site(port, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine:
            await until(lambda: machine.has_token("%news"))
    assert "zenoh: a refresh failed" in caplog.text
