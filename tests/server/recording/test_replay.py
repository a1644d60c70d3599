from __future__ import annotations

import asyncio
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.clients import frame_client
from harness.waiting import TIMEOUT_S, until
from protocol.publication import PublishedMessage
from server.access.settings import AccessSettings
from server.gateway.settings import ServerSettings
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from server.interfaces import load_registry
from server.recording import replay
from server.recording.files import RecordedMessage
from server.recording.reading import messages
from server.recording.replay import RecordingPlayer, serve
from tests.conformance.cases import INTERFACES
from tests.server.recordings import REGISTRY, entry, record, record_killed, text


class Player:
    """A player of a recording, and what a subscriber hears of it."""

    def __init__(self, path: Path, entries: list[RecordedMessage]) -> None:
        self.graph = Graph(REGISTRY)
        self.graph.advertise(Node("server"), "/client_count", "std_msgs/Int32", latch=True)
        self.player = RecordingPlayer(self.graph, record(path / "run.mcap", entries))
        self.heard: list[Any] = []
        self.times_s: list[float] = []
        for topic, type_name in (("/t", "std_msgs/String"), ("/client_count", "std_msgs/Int32")):
            self.graph.subscribe(Node("listener"), topic, type_name, Subscriber(self._take))

    def _take(self, published: PublishedMessage) -> None:
        self.heard.append(published.msg["data"])
        self.times_s.append(asyncio.get_running_loop().time())


@pytest.mark.stepped_time
async def test_messages_are_published_in_order_and_at_their_rate(tmp_path: Path) -> None:
    played = Player(tmp_path, [text(0), text(1), text(3)])
    await played.player.play()
    assert played.heard == ["0", "1", "3"]
    assert (played.player.published, played.player.unreadable) == (3, 0)
    assert np.array(played.times_s) - played.times_s[0] == pytest.approx([0.0, 1.0, 3.0])


@pytest.mark.stepped_time
async def test_what_was_latched_is_so_again_and_what_is_unreadable_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    played = Player(tmp_path, [text(7)._replace(latched=True)])
    await played.player.play()
    assert [published.msg for published in played.graph.subscribe(Node("late"), "/t", None, Subscriber(print))] == [
        {"data": "7"}
    ]
    broken = [text(number)._replace(octets=b"\x00\x01\x00\x00\xff") for number in (1, 2)]
    played = Player(tmp_path, [text(0), *broken, text(3)])
    await played.player.play()
    assert (played.heard, played.player.unreadable) == (["0", "3"], 2)
    assert len([line for line in caplog.messages if "/t: a message of std_msgs/msg/String cannot be read" in line]) == 1


@pytest.mark.stepped_time
async def test_topics_that_cannot_be_offered_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    own = entry("/client_count", "std_msgs/Int32", {"data": 9})
    played = Player(tmp_path, [own, text(1), entry("/t", "std_msgs/Bool", {}, 2)])
    await played.player.play()
    assert (played.heard, played.player.unreadable) == (["1"], 0)
    assert "/t is left out: it cannot be offered: topic /t: is already established" in caplog.text


async def test_playing_can_be_cancelled_at_any_time(tmp_path: Path) -> None:
    played = Player(tmp_path, [text(0), text(1000)])
    playing = asyncio.create_task(played.player.play())
    await until(lambda: played.heard)
    playing.cancel()
    await asyncio.wait([playing], timeout=TIMEOUT_S)
    assert playing.cancelled()


@pytest.mark.stepped_time
async def test_large_messages_are_read_a_few_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "BYTES_AT_A_TIME", 20)
    played = Player(tmp_path, [text(number) for number in range(100)])
    read = []

    def noted(recording: Path) -> Iterator[RecordedMessage]:
        for message in messages(recording):
            read.append(len(played.heard))
            yield message

    monkeypatch.setattr(replay, "messages", noted)
    await played.player.play()
    # How many had been published when each was read.
    assert all(number - published <= 3 for number, published in enumerate(read))
    assert len(played.heard) == 100


# The server.


SERVER = ServerSettings(port=0)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return record(tmp_path / "run.mcap", [text(0)._replace(latched=True), text(1)])


async def test_a_client_hears_a_recording_until_a_signal_ends_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    serving = re.compile(r"ws://127\.0\.0\.1:\d+")
    recording = record(tmp_path / "run.mcap", [text(0)._replace(latched=True), text(1000)])
    playing = asyncio.create_task(serve(recording, SERVER, AccessSettings()))
    await until(lambda: serving.search(caplog.text))
    async with frame_client(serving.findall(caplog.text)[0]) as client:
        await client.subscribe("/t", "std_msgs/String")
        await client.until("/t", lambda messages: [each["data"] for each in messages] == ["0"])
        signal.raise_signal(signal.SIGTERM)
        await asyncio.wait_for(playing, TIMEOUT_S)
    assert "replay ended" in caplog.text


@pytest.mark.stepped_time
async def test_it_ends_with_the_recording(recording: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    await serve(recording, SERVER, AccessSettings())
    assert "replay ended: 2 messages published, 0 could not be read" in caplog.text
    record_killed(recording, [[text(0)]])
    await serve(recording, SERVER, AccessSettings())
    assert "what comes after the last readable chunk is left out" in caplog.text
    assert "1 messages published" in caplog.text


@pytest.mark.parametrize(("interfaces", "published"), [([INTERFACES], 1), ([], 0)])
async def test_types_of_the_users_packages_are_replayed_where_the_settings_name_them(
    recording: Path, caplog: pytest.LogCaptureFixture, interfaces: list[Path], published: int
) -> None:
    caplog.set_level("INFO")
    user = load_registry([INTERFACES])
    record(recording, [entry("/sample", "lab_msgs/Sample", {}, registry=user)], user)
    async with asyncio.timeout(TIMEOUT_S):
        await serve(recording, ServerSettings(port=0, interfaces=interfaces), AccessSettings())
    assert f"replay ended: {published} messages published" in caplog.text
    assert ("/sample is left out: it cannot be offered" in caplog.text) is (published == 0)
