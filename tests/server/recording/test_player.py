from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.recording.mcap_file import Entry
from server.recording.player import Player
from server.recording.reader import Recording, Track
from tests.helpers.recorded import REGISTRY, entry, record, text

LISTENER = Node("listener")


class Heard:
    """What a subscriber got, and when [s]."""

    def __init__(self, graph: Graph, topic: str = "/t") -> None:
        self.messages: list[Any] = []
        self.times_s: list[float] = []
        graph.subscribe(LISTENER, topic, None, Subscriber(lambda publication: self._keep(publication.msg)))

    def _keep(self, message: Any) -> None:
        self.messages.append(message)
        self.times_s.append(asyncio.get_running_loop().time())


def player(path: Path, graph: Graph, entries: list[Entry], rate: float = 100.0) -> Player:
    """A player that has offered what is recorded."""
    recording = Recording(record(path / "run.mcap", entries))
    made = Player(graph, recording, rate)
    made.advertise(recording.outline().tracks)
    return made


async def test_messages_are_published_in_order_and_complete(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    playing = player(tmp_path, graph, [text(number) for number in range(5)])
    heard = Heard(graph)
    await playing.play()
    assert heard.messages == [{"data": str(number)} for number in range(5)]
    assert (playing.tally.published, playing.tally.unreadable) == (5, 0)


@pytest.mark.stepped_time
async def test_the_rate_is_kept(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    playing = player(tmp_path, graph, [text(0), text(1), text(3)], rate=20.0)
    heard = Heard(graph)
    await playing.play()
    offsets_s = [at_s - heard.times_s[0] for at_s in heard.times_s]
    assert offsets_s == pytest.approx([0.0, 0.05, 0.15])


async def test_what_was_latched_is_latched_again(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    await player(tmp_path, graph, [text(7)._replace(latched=True)]).play()
    kept = graph.subscribe(LISTENER, "/t", None, Subscriber(lambda _: None))
    assert [publication.msg for publication in kept] == [{"data": "7"}]


async def test_a_message_that_cannot_be_read_is_left_out_and_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    graph = Graph(REGISTRY)
    broken = [text(number)._replace(octets=b"\x00\x01\x00\x00\xff") for number in (1, 2)]
    playing = player(tmp_path, graph, [text(0), *broken, text(3)])
    heard = Heard(graph)
    await playing.play()
    assert [message["data"] for message in heard.messages] == ["0", "3"]
    assert playing.tally.unreadable == 2
    assert len([line for line in caplog.messages if "/t: a message of std_msgs/msg/String cannot be read" in line]) == 1


async def test_a_topic_of_a_type_nobody_knows_is_left_out_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    graph = Graph(REGISTRY)
    playing = Player(graph, Recording(tmp_path / "run.mcap"))
    playing.advertise([Track("/own", "my_msgs/msg/Thing", False), Track("/t", "std_msgs/msg/String", False)])
    assert list(graph.topic_types()) == ["/t"]
    assert "/own is left out: it cannot be offered" in caplog.text


async def test_the_servers_own_topics_are_not_mixed_with_recorded_ones(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    graph.advertise(Node("server"), "/client_count", "std_msgs/Int32", latch=True)
    playing = player(tmp_path, graph, [entry("/client_count", "std_msgs/Int32", {"data": 9}), text(1)])
    heard = Heard(graph, "/client_count")
    await playing.play()
    assert heard.messages == []


async def test_a_second_type_on_a_topic_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    graph = Graph(REGISTRY)
    playing = player(tmp_path, graph, [text(0), entry("/t", "std_msgs/Bool", {}, 1)])
    heard = Heard(graph)
    await playing.play()
    assert heard.messages == [{"data": "0"}]
    assert playing.tally.unreadable == 0
    assert "/t is left out: it cannot be offered: topic /t: is already established" in caplog.text


async def test_playing_can_be_cancelled_at_any_time(tmp_path: Path) -> None:
    playing = asyncio.create_task(player(tmp_path, Graph(REGISTRY), [text(0), text(1000)], rate=1.0).play())
    await asyncio.sleep(0.02)
    playing.cancel()
    await asyncio.wait([playing], timeout=30.0)
    assert playing.cancelled()
