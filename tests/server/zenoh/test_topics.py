import asyncio
import contextlib
import itertools
import logging
import struct
from typing import cast

import pytest
import zenoh
import zenoh.ext

from harness.waiting import TIMEOUT_S, until
from protocol.publication import PublishedMessage
from server.graph.message_types import BYTES_AT_ONCE, ReceivedMessage
from server.graph.topics import Subscriber
from server.zenoh import topics
from server.zenoh.network import Network
from server.zenoh.session import MAX_WAITING
from tests.helpers.zenoh_network import RosMachine, Site, free_port, networked

STRING, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"

# Messages take milliseconds from one session of this machine to another.
ROUND_S = 2.0
MAX_ROUNDS = 30


async def test_a_message_goes_out_as_a_ros_2_machine_expects_it_until_nobody_publishes_any_more() -> None:
    async with networked(publish=("/news*", "/*\\*")) as (site, machine):
        heard = machine.hear("/news", STRING)
        await until(lambda: machine.has_token("/NN/"))
        for name in ("/other", "/news/**", "/news"):
            site.graph.advertise(site.client, name, STRING)
        # The first message of a client on a new topic is not lost.
        site.graph.publish(site.client, "/news", {"data": "one"}, lifespan_s=TIMEOUT_S)
        await until(lambda: machine.has_token("/MP/%/%/armbridge/%news/std_msgs::msg::dds_::String_/RIHS01_df66"))
        assert len([token for token in machine.tokens if "/MP/" in token]) == 1
        await until(lambda: heard)
        site.graph.publish(site.client, "/news", {"data": "two"})
        await until(lambda: len(heard) == 2)
        site.graph.unadvertise(site.client, "/news")
        await until(lambda: not machine.has_token("%news"))
        assert site.graph.subscribers("/news") == []
    assert [message.data for message, _ in heard] == ["one", "two"]
    first, second = (struct.unpack("<qqB16s", attached) for _, attached in heard)
    assert (first[0], second[0]) == (1, 2)
    assert first[1] <= second[1]
    assert first[2:] == second[2:]


async def test_a_late_subscriber_on_the_network_gets_the_latched_message() -> None:
    async with networked(publish=("/description",)) as (site, machine):
        site.graph.advertise(site.part, "/description", STRING, latch=True)
        site.graph.publish(site.part, "/description", {"data": "an arm"})
        await until(lambda: machine.has_token("%description/std_msgs"))
        assert machine.has_token("/:1:,1:,:,:,,")
        heard: list[bytes] = []
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        zenoh.ext.declare_advanced_subscriber(
            machine.session,
            machine.key("/description", STRING),
            lambda sample: heard.append(bytes(sample.payload)),
            history=history,
        )
        await until(lambda: heard)
        assert heard == [machine.message(STRING, data="an arm")]


async def test_a_topic_whose_message_is_sent_at_once_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    async with networked(publish=("/news",)) as (site, machine):
        heard = machine.hear("/news", STRING)
        site.graph.advertise(site.part, "/news", STRING)
        await until(lambda: machine.has_token("%news"))
        with monkeypatch.context() as patched:
            # As where the session's thread is quicker than the event loop.
            patched.setattr(site.bridge._thread, "submit", lambda job: job(cast("zenoh.Session", None)) is None)
            for text in ("first", "second"):
                site.graph.publish(site.part, "/news", {"data": text})
        await until(lambda: len(heard) == 2)


async def test_of_messages_that_come_faster_than_the_network_takes_them_the_newest_go_out() -> None:
    count = 3 * topics.MAX_WAITING
    dropped = count - topics.MAX_WAITING
    async with networked(publish=("/news",)) as (site, machine):
        site.graph.advertise(site.part, "/news", STRING)
        heard = machine.hear("/news", STRING)
        await until(lambda: machine.has_token("%news"))
        go_on = await site.held_network()
        for number in range(count):
            site.graph.publish(site.part, "/news", {"data": str(number)})
        go_on.set()
        await until(lambda: heard and heard[-1][0].data == str(count - 1))
    assert [message.data for message, _ in heard] == [str(each) for each in range(dropped, count)]
    assert site.bridge.dropped == dropped


GOALS = ("/moveit_goal_*", "/stop")


async def listening(machine: RosMachine, topic: str = "%moveit_goal_named") -> None:
    await until(lambda: machine.has_token(f"/MS/%/%/armbridge/{topic}/"))


async def test_a_stop_arrives_whatever_flood_of_goals_comes_behind_it() -> None:
    async with networked(subscribe=GOALS) as (site, machine), asyncio.timeout(TIMEOUT_S):
        stops = site.hear("/stop", EMPTY, site.part)
        site.hear("/moveit_goal_named", STRING, site.part)
        await listening(machine)
        await listening(machine, "%stop")
        machine.publish("/stop", EMPTY)
        for _ in range(20 * MAX_WAITING):
            machine.publish("/moveit_goal_named", STRING, data="ready")
        await until(lambda: site.bridge.dropped > MAX_WAITING)
        await until(lambda: stops)


async def test_a_goal_in_the_namespace_is_for_this_server_and_one_outside_is_not() -> None:
    async with networked(subscribe=GOALS, namespace="/arm1") as (site, machine):
        goals = site.hear("/moveit_goal_named", STRING, site.part)
        await until(lambda: machine.has_token("%arm1%moveit_goal_named"))
        machine.publish("/moveit_goal_named", STRING, data="other")
        machine.publish("/arm1/moveit_goal_named", STRING, data="own")
        await until(lambda: goals)
    assert [goal.msg["data"] for goal in goals] == ["own"]


async def test_topics_of_other_machines_that_fit_a_pattern_are_there_for_clients_until_they_go() -> None:
    async with networked(subscribe=("/camera/*",)) as (site, machine):
        goals = site.hear("/moveit_goal_named", STRING, site.part)
        machine.announce_topic("/moveit_goal_named", STRING)
        machine.announce_topic("/camera/name", STRING)
        await until(lambda: site.graph.topic_type("/camera/name") == STRING)
        names = site.hear("/camera/name")
        await listening(machine, "%camera%name")
        machine.publish("/moveit_goal_named", STRING, data="ready")
        machine.publish("/camera/name", STRING, data="front")
        await until(lambda: names)
        assert not machine.has_token("/MS/%/%/armbridge/%moveit_goal_named")
        machine.session.close()
        await until(lambda: not site.graph.publishers("/camera/name"))
    assert goals == []


async def test_received_messages_are_not_sent_back_nor_their_topics_announced() -> None:
    async with networked(subscribe=("/chat",), publish=("/*",)) as (site, machine):
        machine.announce_topic("/chat", STRING)
        await listening(machine, "%chat")
        site.graph.advertise(site.part, "/news", STRING)
        await until(lambda: machine.has_token("/MP/%/%/armbridge/%news/"))
        assert not machine.has_token("/MP/%/%/armbridge/%chat/")
        site.graph.advertise(site.client, "/chat", STRING)
        await until(lambda: machine.has_token("/MP/%/%/armbridge/%chat/"))
        heard, echoes = site.hear("/chat", STRING), machine.hear("/chat", STRING)
        machine.publish("/chat", STRING, data="hello")
        await until(lambda: heard)
        site.graph.publish(site.client, "/chat", {"data": "answer"})
        await until(lambda: len(echoes) == 2)
        machine.publish("/chat", STRING, data="end")
        await until(lambda: len(echoes) == 3 and heard[-1].msg["data"] == "end")
    assert [message.data for message, _ in echoes] == [message.msg["data"] for message in heard]
    assert [message.msg["data"] for message in heard] == ["hello", "answer", "end"]


async def test_another_machine_cannot_speak_for_the_arm(caplog: pytest.LogCaptureFixture) -> None:
    async with networked(subscribe=("/*",)) as (site, machine):
        site.graph.advertise(site.part, "/joint_states", STRING)
        heard, news = site.hear("/joint_states"), site.hear("/news", STRING)
        machine.announce_topic("/joint_states", STRING)
        machine.announce_topic("/news", STRING)
        await listening(machine, "%news")
        machine.publish("/joint_states", STRING, data="false")
        machine.publish("/news", STRING, data="true")
        await until(lambda: news)
    assert heard == []
    assert "set zenoh.namespace on one of them" in caplog.text


async def test_a_goal_that_was_latched_before_the_server_came_does_not_move_the_arm() -> None:
    port = free_port()
    async with Site(port, mode="router"):
        with RosMachine(port) as machine:
            publisher = zenoh.ext.declare_advanced_publisher(
                machine.session,
                machine.key("/moveit_goal_named", STRING),
                cache=zenoh.ext.CacheConfig(1),
                publisher_detection=True,
            )
            machine.announce_topic("/moveit_goal_named", STRING, ":1:,1:,:,:,,")
            publisher.put(machine.message(STRING, data="old"))
            site = Site(to=(port,), mode="client", subscribe=GOALS)
            goals = site.hear("/moveit_goal_named", STRING, site.part)
            async with site:
                await listening(machine)
                publisher.put(machine.message(STRING, data="new"))
                await until(lambda: goals)
                publisher.put(machine.message(STRING, data="newer"))
                await until(lambda: len(goals) > 1)
    assert [goal.msg["data"] for goal in goals] == ["new", "newer"]


async def test_garbage_costs_a_warning_and_a_publisher_of_another_type_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with networked(max_message_bytes=100, subscribe=(*GOALS, "/news")) as (site, machine):
        goals = site.hear("/moveit_goal_named", STRING, site.part)
        machine.announce_topic("/moveit_goal_named", "std_msgs/msg/Bool")
        machine.announce_topic("/news", STRING)
        await listening(machine)
        # Announced after the other, and so known after it.
        await until(lambda: site.graph.topic_type("/news") == STRING)
        key = machine.key("/moveit_goal_named", STRING)
        # A key for all topics is for none.
        machine.session.put("0/**", machine.message(STRING, data="every"))
        for octets in (b"", b"\0\1\0\0\xff\xff\xff\xff", machine.message(STRING, data="x" * 200)):
            machine.session.put(key, octets)
        machine.publish("/moveit_goal_named", STRING, data="ready")
        await until(lambda: goals)
    assert [goal.msg["data"] for goal in goals] == ["ready"]
    assert caplog.text.count("a message on /moveit_goal_named is left out") == 3
    assert "more than 100 bytes (server.limits.max_message_bytes)" in caplog.text


async def test_a_viewing_network_sends_no_goals_and_is_answered(caplog: pytest.LogCaptureFixture) -> None:
    on_unauthorized: list[str] = []
    async with networked(subscribe=GOALS, role="view") as (site, machine):
        goals, stops = [], site.hear("/stop", "std_msgs/msg/Empty", site.part)
        subscriber = Subscriber(goals.append, None, lambda _asked, _sender, reason: on_unauthorized.append(reason))
        site.graph.subscribe(site.part, "/moveit_goal_named", STRING, subscriber)
        await listening(machine)
        machine.publish("/moveit_goal_named", STRING, data="ready")
        await until(lambda: on_unauthorized)
        machine.publish("/stop", "std_msgs/msg/Empty")
        await until(lambda: stops)
    assert goals == []
    assert "needs the role operate" in on_unauthorized[0]
    assert [record.levelno for record in caplog.records if "needs the role" in record.message] == [logging.WARNING]


async def test_a_topic_of_another_version_of_its_type_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    async with networked(subscribe=("/*",)) as (site, machine):
        machine.announce("MP", "/news", f"std_msgs::msg::dds_::String_/RIHS01_{'0' * 64}")
        await until(lambda: "another version of std_msgs/msg/String" in caplog.text)
        machine.announce("MP", "/news", f"std_msgs::msg::dds_::String_/RIHS01_{'0' * 64}")
        machine.announce_topic("/camera/news", STRING)
        await until(lambda: site.graph.topic_type("/camera/news") == STRING)
    assert caplog.text.count("another version") == 1
    assert site.graph.topic_type("/news") is None


async def test_a_small_message_after_a_large_one_waits_for_it() -> None:
    port = free_port()
    texts = ["x" * 300_000, "small", "y" * 200_000, "last"]
    async with Site(port, subscribe=("/camera/*",)) as site, Site(to=(port,), publish=("/camera/*",)) as camera:
        camera.graph.advertise(camera.part, "/camera/news", STRING)
        await until(lambda: site.graph.topic_type("/camera/news") == STRING)
        heard = site.hear("/camera/news", STRING)
        await until(lambda: camera.graph.subscribers("/camera/news"))
        # zenoh drops what a starved link does not take at once, so they are sent until all have come once.
        for first in itertools.count(0, len(texts)):
            for number, text in enumerate(texts, first):
                camera.graph.publish(camera.part, "/camera/news", {"data": f"{number} {text}"})
            with contextlib.suppress(TimeoutError):
                await until(lambda first=first: len(numbers_of(heard, first)) == len(texts), ROUND_S)
                break
            assert first < MAX_ROUNDS * len(texts)
        heard_numbers = numbers_of(heard)
    assert heard_numbers == sorted(heard_numbers)


async def test_a_large_message_for_which_there_is_no_memory_is_left_out_and_the_next_ones_come(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def decode(_network: Network, _type_name: str, _octets: bytes) -> ReceivedMessage:
        raise MemoryError

    monkeypatch.setattr(Network, "decode", decode)
    async with networked(subscribe=("/news",)) as (site, machine):
        heard = site.hear("/news", STRING, site.part)
        await listening(machine, "%news")
        machine.publish("/news", STRING, data="x" * (BYTES_AT_ONCE + 1))
        machine.publish("/news", STRING, data="small")
        await until(lambda: heard)
    assert "a message on /news is left out: out of memory" in caplog.text
    assert [published.msg["data"] for published in heard] == ["small"]


def numbers_of(heard: list[PublishedMessage], first: int = 0) -> list[int]:
    """The numbers that messages begin with, from one on."""
    numbers = [int(published.msg["data"].split()[0]) for published in heard]
    return [number for number in numbers if number >= first]
