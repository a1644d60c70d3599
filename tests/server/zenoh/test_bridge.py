import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from harness.server import ROOT
from harness.waiting import TIMEOUT_S, until
from server.zenoh import bridge
from server.zenoh.bridge import FULL_REFRESH_PERIOD_S, Discovery, Sharing
from server.zenoh.rmw import Endpoint, Entity, EntityKind, LivelinessTokens
from server.zenoh.settings import ZenohSettings
from server.zenoh.topics import OutgoingTopics
from tests.helpers.resources import Pair, make_pair, make_signed_pair
from tests.helpers.zenoh_network import RosMachine, Site, free_port, networked
from tests.test_readme import blocks

STRING, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"


async def test_servers_find_each_other_in_whichever_order_they_start() -> None:
    port = free_port()
    async with Site(to=(port,), subscribe=("/arm1/*",)) as viewer:
        async with Site(port, namespace="/arm1", publish=("/news",)) as site:
            site.graph.advertise(site.part, "/news", STRING)
            await until(lambda: viewer.graph.topic_type("/arm1/news") == STRING)
        await until(lambda: not viewer.graph.publishers("/arm1/news"))


async def test_other_domains_are_neither_seen_nor_heard() -> None:
    port = free_port()
    async with Site(port, domain_id=7, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine, RosMachine(port, domain_id=7) as inside:
            # What one of the machines there sees, the other would have seen as well.
            await until(lambda: inside.has_token("/MP/%/%/armbridge/%news"))
            assert machine.tokens == set()


async def test_the_network_is_left_at_once_with_all_that_was_shared(caplog: pytest.LogCaptureFixture) -> None:
    async with networked(publish=("/news",), subscribe=("/chat",), offer=("/arm/*",)) as (site, machine):
        site.graph.advertise(site.part, "/news", STRING)
        machine.announce_topic("/chat", STRING)
        await until(lambda: machine.has_token("/MS/") and machine.has_token("/MP/%/%/armbridge"))
        await site.leave()
        await until(lambda: not machine.has_token("armbridge"))
    assert site.graph.publishers("/chat") == site.graph.subscribers("/news") == []
    assert "the network was not left in time" not in caplog.text


def with_certificate(authority: Pair, folder: Path) -> Path:
    """zenoh's file of a machine that has a certificate, as the page shows it."""
    machine = make_signed_pair(folder, authority)
    (text,) = blocks(ROOT / "docs" / "zenoh.md", "json5")
    paths = {"authority.pem": authority.certificate, "machine.pem": machine.certificate, "machine.key": machine.key}
    for name, path in paths.items():
        text = text.replace(f'"{name}"', f'"{path}"')
    (folder / "zenoh.json5").write_text(text)
    return folder / "zenoh.json5"


async def test_with_certificates_only_who_has_one_takes_part(tmp_path: Path) -> None:
    authority, port = make_pair(tmp_path / "authority", "lab"), free_port()
    stranger = tmp_path / "zenoh.json5"
    stranger.write_text(f'{{ transport: {{ link: {{ tls: {{ root_ca_certificate: "{authority.certificate}" }} }} }} }}')
    arm, viewer = (with_certificate(authority, tmp_path / name) for name in ("arm", "viewer"))
    connect: dict[str, Any] = {"connect": (f"tls/localhost:{port}",), "subscribe": ("/news",)}
    async with Site(listen=(f"tls/127.0.0.1:{port}",), config_file=arm, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        async with Site(config_file=stranger, **connect) as other, Site(config_file=viewer, **connect) as known:
            await until(lambda: known.graph.topic_type("/news") == STRING)
            assert other.graph.topic_type("/news") is None


async def test_a_bridge_that_has_not_joined_yet_ends() -> None:
    running = asyncio.create_task(Site(free_port()).bridge.run())
    await asyncio.sleep(0)
    running.cancel()
    await asyncio.wait([running], timeout=TIMEOUT_S)
    assert running.cancelled()


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
    async with networked(namespace="/arm1", publish=("/joint_states", "/news")) as (site, machine):
        machine.announce_topic("/joint_states", STRING)
        for node, topic in ((site.client, "news"), (site.part, "joint_states")):
            site.graph.advertise(node, f"/{topic}", STRING)
            await until(lambda topic=topic: machine.has_token(f"/MP/%/%arm1/armbridge/%arm1%{topic}/"))


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
        await until(lambda: {"/arm1/joint_states", "/arm2/joint_states"} <= edge.graph.topic_names.types().keys())
        heard = edge.hear("/arm1/joint_states"), edge.hear("/arm2/joint_states")
        await until(lambda: all(heard))
    assert [messages[0].msg["data"] for messages in heard] == ["/arm1", "/arm2"]


async def test_a_network_that_may_send_goals_may_stop_the_arm() -> None:
    async with networked(subscribe=("/moveit_goal_named",), offer=("/arm/enable",)) as (site, machine):
        for topic in ("/moveit_goal_named", "/moveit_goal_joints", "/stop"):
            site.hear(topic, STRING, site.part)
        for service in ("/arm/enable", "/arm/relax", "/arm/stop"):
            site.graph.services.offer(site.part, service, "std_srvs/Trigger", lambda _request: {})
        await until(lambda: machine.has_token("/MS/%/%/armbridge/%stop/"))
        await until(lambda: machine.has_token("/SS/%/%/armbridge/%arm%stop/"))
        assert not machine.has_token("%moveit_goal_joints")
        assert not machine.has_token("%arm%relax")


@pytest.mark.parametrize("publish", [(), ("/arm1/moveit_goal_*",)])
async def test_a_stop_reaches_the_other_arm_whatever_is_published(publish: tuple[str, ...]) -> None:
    port, names = free_port(), ("/stop", "/emergency_stop", "/left/stop", "/left/emergency_stop")
    async with (
        Site(port, namespace="/arm1", arms=("left", "right"), subscribe=("/moveit_goal_*",)) as arm,
        Site(to=(port,), publish=publish, subscribe=("/arm1/*",)) as edge,
    ):
        for name in names:
            stops = arm.hear(name, EMPTY, arm.part)
            await edge.until_seen(f"/MS/%/%arm1/armbridge/%arm1{name.replace('/', '%')}/")
            edge.graph.advertise(edge.client, f"/arm1{name}", EMPTY)
            edge.graph.publish(edge.client, f"/arm1{name}", {}, lifespan_s=TIMEOUT_S)
            await until(lambda stops=stops: stops)


async def test_an_arm_that_takes_nothing_else_of_others_takes_their_stop() -> None:
    async with networked(publish=("/joint_states",)) as (site, machine):
        stops = site.hear("/stop", EMPTY, site.part)
        await until(lambda: machine.has_token("/MS/%/%/armbridge/%stop/"))
        machine.publish("/stop", EMPTY)
        await until(lambda: stops)


async def test_a_topic_of_a_client_that_does_not_go_out_is_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    async with Site(free_port(), publish=("/arm1/moveit_goal_named",)) as edge:
        edge.hear("/moveit_goal_named", STRING, edge.part)
        for name in ("/arm1/moveit_goal_named", "/arm1/stop", "/moveit_goal_named", "/arm1/moveit_goal_pose"):
            edge.graph.advertise(edge.client, name, STRING)
        await until(lambda: "zenoh.publish" in caplog.text)
        edge.graph.unadvertise(edge.client, "/arm1/moveit_goal_pose")
        edge.graph.advertise(edge.client, "/arm1/moveit_goal_pose", STRING)
        edge.graph.advertise(edge.client, "/arm1/last", STRING)
        await until(lambda: "/arm1/last" in caplog.text)
    warned = [record.message for record in caplog.records if "zenoh.publish" in record.message]
    reason = "of a client does not go to other machines; zenoh.publish does not list it"
    assert warned == [f"zenoh: {name} {reason}" for name in ("/arm1/moveit_goal_pose", "/arm1/last")]
    # As a warning, clients that publish there get it too.
    assert edge.graph.remarks["/arm1/last"] == f"topic /arm1/last {reason}"


async def test_the_sharing_outlives_an_error(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    refresh, failures = OutgoingTopics.refresh, iter([True])

    def fail_once(topics: OutgoingTopics, foreign: frozenset[str]) -> None:
        if next(failures, False):
            raise RuntimeError("a bug")
        refresh(topics, foreign)

    monkeypatch.setattr(OutgoingTopics, "refresh", fail_once)
    async with networked(publish=("/news",)) as (site, machine):
        site.graph.advertise(site.part, "/news", STRING)
        await until(lambda: machine.has_token("%news"))
    assert "zenoh: a refresh failed" in caplog.text


CHATTER = Endpoint("/chatter", "std_msgs/msg/String", "RIHS01_0")


class Found:
    """What a server discovers of another machine; ``concerns`` tells what it is about."""

    def __init__(self, concerns: Callable[[Entity], bool] = lambda _entity: True) -> None:
        self.discovery = Discovery(0, "us", concerns)
        self.theirs, self.ours = (LivelinessTokens(0, machine, "") for machine in ("them", "us"))

    def token(self, topic: str = "/chatter") -> str:
        """A new token of the other machine for a topic that it publishes."""
        return self.theirs.entity(EntityKind.PUBLISHER, Endpoint(topic, CHATTER.type_name, "RIHS01_0"))

    def update(self, token: str, *, alive: bool = True) -> tuple[Entity, ...]:
        """Take a token; returns what is known then."""
        self.discovery.update(token, alive=alive)
        return self.discovery.entities()


def test_an_entity_of_others_is_known_until_the_last_of_its_valid_tokens_goes() -> None:
    found = Found()
    first, second = found.token(), found.token()
    known = (Entity(EntityKind.PUBLISHER, "them", CHATTER, latched=False),)
    assert found.update(first) == found.update(second) == found.update(first, alive=False) == known
    assert found.update(second, alive=False) == ()
    services, found = Found(lambda entity: entity.kind is EntityKind.SERVICE), Found()
    assert services.update(services.token()) == ()
    assert found.update(found.ours.entity(EntityKind.PUBLISHER, CHATTER)) == ()
    for alive in (True, False):
        assert found.update("@ros2_lv/0/nonsense", alive=alive) == ()


def test_invented_liveliness_tokens_fill_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge, "MAX_ENTITIES", 3)
    found = Found()
    for number in range(10):
        found.update(found.token(f"/t{number}"))
    assert len(found.discovery.entities()) == 3


async def test_names_are_looked_at_again_after_changes_and_from_time_to_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, refreshes, settings = 0.0, [], ZenohSettings(mode="peer", publish=("/news",))
    async with Site(free_port(), publish=("/news",)) as site:
        network = site.bridge._sharing._network  # type: ignore[union-attr]
        monkeypatch.setattr(network.graph, "clock", lambda: now_s)
        sharing = Sharing(network, settings, site.bridge._authorizer)
        monkeypatch.setattr(sharing, "refresh", lambda: refreshes.append(now_s))

        def follow() -> int:
            for _ in range(3):
                sharing.follow()
            return len(refreshes)

        assert follow() == 1
        site.graph.advertise(site.part, "/news", STRING)
        assert follow() == 2
        now_s += FULL_REFRESH_PERIOD_S
        assert follow() == 3
