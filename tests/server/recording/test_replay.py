from __future__ import annotations

import asyncio
import re
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from harness.clients import frame_client
from harness.waiting import TIMEOUT_S, until
from server.access.settings import AccessSettings
from server.errors import RecordingError
from server.gateway.settings import ServerSettings
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.interfaces import load_registry
from server.recording import replay as replay_module
from server.recording.files import RecordedMessage
from server.recording.replay import RecordedTopic, RecordingFile, RecordingPlayer, ReplayOptions, ReplayServer
from tests.conformance.cases import INTERFACES
from tests.server.recordings import REGISTRY, START_NS, entry, record, record_killed, recorded_messages, text

CHUNKS = [[text(0), text(1)], [text(2), text(3)], [text(4)]]


def test_the_summary_tells_topics_count_and_length(tmp_path: Path) -> None:
    summary = RecordingFile(record(tmp_path / "run.mcap", map(text, range(4)))).summary()
    assert summary.topics == [RecordedTopic("/t", "std_msgs/msg/String", False)]
    assert (summary.messages, summary.duration_s, summary.complete) == (4, 3.0, True)


def test_the_recording_of_a_killed_server_is_read_to_its_last_chunk(tmp_path: Path) -> None:
    path = record_killed(tmp_path / "run.mcap", CHUNKS)
    summary = RecordingFile(path).summary()
    assert (summary.messages, summary.duration_s, summary.complete) == (5, 4.0, False)
    assert [track.topic for track in summary.topics] == ["/t"]


def test_of_a_file_cut_anywhere_the_whole_chunks_are_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    octets = record_killed(tmp_path / "run.mcap", CHUNKS).read_bytes()
    counts = []
    for length in range(10, len(octets), 7):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(octets[:length])
        try:
            counts.append(len(recorded_messages(cut)))
        except RecordingError:
            counts.append(0)
    assert counts == sorted(counts)
    assert set(counts) == {0, 2, 4, 5}
    assert "what comes after the last readable chunk is left out" in caplog.text


def test_a_damaged_chunk_ends_the_reading(tmp_path: Path) -> None:
    octets = bytearray(record_killed(tmp_path / "run.mcap", CHUNKS).read_bytes())
    second = octets.index(b"zstd", octets.index(b"zstd") + 1)
    octets[second + 24] ^= 0xFF
    (tmp_path / "run.mcap").write_bytes(octets)
    assert len(recorded_messages(tmp_path / "run.mcap")) == 2


def test_a_chunk_that_claims_to_be_huge_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(tmp_path / "run.mcap", [text(0)._replace(octets=bytes(50_000))])
    monkeypatch.setattr(replay_module, "MAX_RECORD_BYTES", 10_000)
    assert recorded_messages(path) == []


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunks", [True, False])
def test_files_of_other_writers_are_read(tmp_path: Path, compression: CompressionType, chunks: bool) -> None:
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream, compression=compression, use_chunking=chunks)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/t", "cdr", schema)
        for number in range(3):
            writer.add_message(channel, START_NS + number, text(number).octets, START_NS)
        writer.finish()
    assert [each.octets for each in recorded_messages(tmp_path / "other.mcap")] == [
        text(number).octets for number in range(3)
    ]


def test_a_file_without_messages_of_ros_2_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/t", "json", 0), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="no messages of ROS 2: /t is encoded as 'json', not 'cdr'"):
        RecordingFile(tmp_path / "other.mcap").summary()


NO_RECORDINGS: dict[str, tuple[Callable[[Path], object], str]] = {
    "text": (lambda path: path.write_bytes(b"a text that is longer than eight characters"), "is not an MCAP file"),
    "an empty file": (Path.touch, "is not an MCAP file"),
    "magic alone": (lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "is not an MCAP file"),
    "no file": (lambda _path: None, "cannot be read: No such file"),
    "nothing recorded": (lambda path: record(path, []), "has no messages of ROS 2"),
}


@pytest.mark.parametrize(("make", "words"), NO_RECORDINGS.values(), ids=NO_RECORDINGS.keys())
def test_an_invalid_recording_is_refused_in_words(tmp_path: Path, make: Callable[[Path], object], words: str) -> None:
    make(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match=rf"run\.mcap: {words}"):
        RecordingFile(tmp_path / "run.mcap").summary()


LISTENER = Node("listener")


class Heard:
    """Return the messages of a subscriber and their times [s]."""

    def __init__(self, graph: Graph, topic: str = "/t") -> None:
        self.messages: list[Any] = []
        self.times_s: list[float] = []
        graph.subscribe(LISTENER, topic, None, Subscriber(lambda published: self._keep(published.msg)))

    def _keep(self, message: Any) -> None:
        self.messages.append(message)
        self.times_s.append(asyncio.get_running_loop().time())


def player(path: Path, graph: Graph, entries: list[RecordedMessage], rate: float = 100.0) -> RecordingPlayer:
    """A player that has offered what is recorded."""
    recording = RecordingFile(record(path / "run.mcap", entries))
    made = RecordingPlayer(graph, recording, rate)
    made.advertise(recording.summary().topics)
    return made


async def test_messages_are_published_in_order_and_complete(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    playing = player(tmp_path, graph, [text(number) for number in range(5)])
    heard = Heard(graph)
    await playing.play()
    assert heard.messages == [{"data": str(number)} for number in range(5)]
    assert (playing.published, playing.unreadable) == (5, 0)


@pytest.mark.stepped_time
async def test_the_rate_is_kept(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    playing = player(tmp_path, graph, [text(0), text(1), text(3)], rate=20.0)
    heard = Heard(graph)
    await playing.play()
    offsets_s = [at_s - heard.times_s[0] for at_s in heard.times_s]
    assert offsets_s == pytest.approx([0.0, 0.05, 0.15])


async def test_a_latched_message_is_latched_again(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    await player(tmp_path, graph, [text(7)._replace(latched=True)]).play()
    kept = graph.subscribe(LISTENER, "/t", None, Subscriber(lambda _: None))
    assert [published.msg for published in kept] == [{"data": "7"}]


async def test_an_unreadable_message_is_told_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    graph = Graph(REGISTRY)
    broken = [text(number)._replace(octets=b"\x00\x01\x00\x00\xff") for number in (1, 2)]
    playing = player(tmp_path, graph, [text(0), *broken, text(3)])
    heard = Heard(graph)
    await playing.play()
    assert [message["data"] for message in heard.messages] == ["0", "3"]
    assert playing.unreadable == 2
    assert len([line for line in caplog.messages if "/t: a message of std_msgs/msg/String cannot be read" in line]) == 1


async def test_a_topic_of_unknown_type_is_left_out_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    graph = Graph(REGISTRY)
    playing = RecordingPlayer(graph, RecordingFile(tmp_path / "run.mcap"))
    playing.advertise(
        [RecordedTopic("/own", "my_msgs/msg/Thing", False), RecordedTopic("/t", "std_msgs/msg/String", False)]
    )
    assert list(graph.topic_names.types()) == ["/t"]
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
    assert playing.unreadable == 0
    assert "/t is left out: it cannot be offered: topic /t: is already established" in caplog.text


async def test_playing_can_be_cancelled_at_any_time(tmp_path: Path) -> None:
    graph = Graph(REGISTRY)
    playing = asyncio.create_task(player(tmp_path, graph, [text(0), text(1000)], rate=1.0).play())
    await until(lambda: "/t" in graph.topic_names.types())
    playing.cancel()
    await asyncio.wait([playing], timeout=TIMEOUT_S)
    assert playing.cancelled()


# The server.

SERVING = re.compile(r"ws://127\.0\.0\.1:\d+")


@pytest.fixture
def options(tmp_path: Path) -> ReplayOptions:
    path = record(tmp_path / "run.mcap", [text(number) for number in range(3)])
    return ReplayOptions(path, ServerSettings(port=0), AccessSettings(), rate=100.0, delay_s=0.0, loop=False)


async def url(caplog: pytest.LogCaptureFixture) -> str:
    """Return the address of the replay, from its log."""
    await until(lambda: SERVING.search(caplog.text))
    return SERVING.findall(caplog.text)[0]


async def test_it_ends_with_the_recording(options: ReplayOptions, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with asyncio.timeout(TIMEOUT_S):
        await ReplayServer(options).run()
    assert "1 topics, 3 messages, 2.0 s" in caplog.text
    assert "replay ended: 3 messages published, 0 could not be read" in caplog.text


async def test_a_loop_repeats_until_a_signal_ends_it(options: ReplayOptions, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    playing = asyncio.create_task(ReplayServer(replace(options, loop=True)).run())
    async with frame_client(await url(caplog)) as client:
        await client.subscribe("/t", "std_msgs/String")
        await client.until("/t", lambda messages: [each["data"] for each in messages].count("2") >= 2)
        signal.raise_signal(signal.SIGTERM)
        await asyncio.wait_for(playing, TIMEOUT_S)
    assert "replay ended" in caplog.text


async def test_an_unended_recording_is_played(options: ReplayOptions, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    record_killed(options.path, [[text(0)], [text(1)]])
    await ReplayServer(options).run()
    assert "not ended in good order" in caplog.text
    assert "2 messages published" in caplog.text


@pytest.mark.parametrize(("interfaces", "published"), [([INTERFACES], 1), ([], 0)])
async def test_types_of_the_users_packages_are_replayed_where_the_settings_name_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, interfaces: list[Path], published: int
) -> None:
    caplog.set_level("INFO")
    user = load_registry([INTERFACES])
    path = record(tmp_path / "user.mcap", [entry("/sample", "lab_msgs/Sample", {}, registry=user)], user)
    server = ServerSettings(port=0, interfaces=interfaces)
    async with asyncio.timeout(TIMEOUT_S):
        await ReplayServer(ReplayOptions(path, server, AccessSettings(), rate=100.0, delay_s=0.0, loop=False)).run()
    assert f"replay ended: {published} messages published" in caplog.text
