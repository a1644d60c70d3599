from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.waiting import TIMEOUT_S, wait_until
from protocol.codecs.cdr import deserialize
from protocol.messages import Stamp, complete
from protocol.publication import PublishedMessage
from server.config import RecordingSettings
from server.errors import StartError
from server.graph.node import Node
from server.graph.topics import Graph
from server.recording import recorder as recorder_module
from server.recording.files import RecordedMessage, RecordingSeries
from server.recording.recorder import QueuedMessage, Recorder, WriterThread
from server.recording.replay import RecordingFile
from tests.server.recordings import REGISTRY, recorded_messages

TALKER = Node("talker")


@pytest.fixture
def graph() -> Graph:
    return Graph(REGISTRY, relay_unknown_types=True)


async def recorded(graph: Graph, path: Path, publish: Callable[[], None]) -> list[RecordedMessage]:
    """Return the messages in the file after something was published."""
    recorder = Recorder(graph, path, RecordingSettings())
    recorder.start()
    publish()
    await recorder.close()
    return [each for chunk in RecordingFile(path).chunks() for each in chunk]


async def test_every_message_of_every_topic_is_recorded_with_nobody_listening(graph: Graph, tmp_path: Path) -> None:
    def publish() -> None:
        graph.advertise(TALKER, "/a", "std_msgs/String")
        graph.advertise(TALKER, "/b", "geometry_msgs/Point", latch=True)
        graph.publish(TALKER, "/a", {"data": "x"})
        graph.publish(TALKER, "/b", {"x": 1.5})

    a, b = await recorded(graph, tmp_path / "run.mcap", publish)
    assert (a.topic, a.latched, b.topic, b.latched) == ("/a", False, "/b", True)
    assert deserialize(REGISTRY, b.type_name, b.octets) == {"x": 1.5, "y": 0.0, "z": 0.0}


async def test_times_are_of_the_epoch_and_do_not_jump_with_the_wall_clock(graph: Graph, tmp_path: Path) -> None:
    monotonic_ns = iter([5, 7, 9])
    recorder = Recorder(
        graph,
        tmp_path / "run.mcap",
        RecordingSettings(),
        clock_ns=lambda: next(monotonic_ns),
        wall_clock_ns=lambda: 1_000_005,
    )
    recorder.start()
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    graph.publish(TALKER, "/a", {})
    await recorder.close()
    entries = recorded_messages(tmp_path / "run.mcap")
    assert [each.log_time_ns for each in entries] == [1_000_007, 1_000_009]


async def test_a_message_of_an_unknown_type_is_left_out_and_told_once(
    graph: Graph, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def publish() -> None:
        graph.advertise(TALKER, "/own", "my_msgs/Thing")
        graph.publish(TALKER, "/own", {"a": 1})
        graph.publish(TALKER, "/own", {"a": 2})

    assert await recorded(graph, tmp_path / "run.mcap", publish) == []
    told = [line for line in caplog.messages if "left out" in line]
    assert told == ["recording: /own is left out, the type my_msgs/msg/Thing is unknown"]


async def test_the_recorder_shows_its_queue(graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "POLL_PERIOD_S", 60.0)
    recorder = Recorder(graph, tmp_path / "run.mcap", RecordingSettings())
    recorder.start()
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    assert (recorder.ended, recorder.queued) == (False, 1)
    await recorder.close()
    assert (recorder.ended, recorder.queued) == (True, 0)


async def test_after_its_end_nothing_is_taken(graph: Graph, tmp_path: Path) -> None:
    await recorded(graph, tmp_path / "run.mcap", lambda: None)
    assert graph._watchers == ()
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    assert [each for chunk in RecordingFile(tmp_path / "run.mcap").chunks() for each in chunk] == []


def test_a_file_that_cannot_be_written_is_refused_with_its_name(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(StartError, match=r"recording\.file: .*nowhere/run\.mcap cannot be written: No such file"):
        Recorder(graph, tmp_path / "nowhere" / "run.mcap", RecordingSettings()).start()


async def test_what_is_published_before_the_file_is_opened_is_in_it(graph: Graph, tmp_path: Path) -> None:
    recorder = Recorder(graph, tmp_path / "run.mcap", RecordingSettings())
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    assert not (tmp_path / "run.mcap").exists()
    recorder.start()
    graph.publish(TALKER, "/a", {})
    await recorder.close()
    assert [each.topic for each in recorded_messages(tmp_path / "run.mcap")] == ["/a", "/a"]


# The thread.


class BlockedFiles(RecordingSeries):
    """Files on a disk that stands still until it is let go."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, REGISTRY, {}, None, 0)
        self.reached = threading.Event()
        self.go_on = threading.Event()

    def add(self, entry: RecordedMessage) -> None:
        self.reached.set()
        assert self.go_on.wait(TIMEOUT_S)
        super().add(entry)


class FullDisk(RecordingSeries):
    """Files on a disk that has no room any more; the errors are the system's."""

    def add(self, entry: RecordedMessage) -> None:
        with Path("/dev/full").open("wb", buffering=0) as full:
            full.write(entry.octets)


def queued(number: int = 0, size_bytes: int = 20) -> QueuedMessage:
    stamp = Stamp(7, 5)
    msg = complete(REGISTRY, "std_msgs/msg/String", {"data": str(number)}, stamp)
    return QueuedMessage(
        PublishedMessage("/t", "std_msgs/msg/String", msg, REGISTRY, stamp), False, size_bytes, 1000 + number
    )


def test_queued_messages_are_in_the_file_in_order(tmp_path: Path) -> None:
    writer = WriterThread(REGISTRY)
    writer.start(RecordingSeries(tmp_path / "run.mcap", REGISTRY, {}, None, 0))
    for number in range(100):
        writer.put(queued(number))
    assert writer.close()
    entries = recorded_messages(tmp_path / "run.mcap")
    assert [each.log_time_ns for each in entries] == list(range(1000, 1100))
    assert {each.publish_time_ns for each in entries} == {7_000_000_005}


@pytest.mark.parametrize(
    ("limit", "value"), [("MAX_QUEUED_MESSAGES", 3), ("MAX_QUEUED_BYTES", 80)], ids=["messages", "bytes"]
)
def test_a_disk_that_stands_still_costs_messages_and_not_memory(
    limit: str, value: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, limit, value)
    files = BlockedFiles(tmp_path / "run.mcap")
    writer = WriterThread(REGISTRY)
    writer.start(files)
    writer.put(queued())
    assert files.reached.wait(TIMEOUT_S)
    for number in range(1, 11):
        writer.put(queued(number))
    assert (writer.dropped, writer.queued) == (7, 3)
    files.go_on.set()
    assert writer.close()
    assert "7 messages were dropped" in caplog.text
    assert len(recorded_messages(tmp_path / "run.mcap")) == 4


def test_a_full_disk_ends_the_recording_with_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    writer = WriterThread(REGISTRY)
    writer.start(FullDisk(tmp_path / "run.mcap", REGISTRY, {}, None, 0))
    for number in range(10):
        writer.put(queued(number))
    wait_until(lambda: writer.ended)
    assert writer.close()
    errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert errors == [
        f"recording ended: {tmp_path / 'run.mcap'} cannot be written any further: No space left on device"
    ]


def test_a_recent_message_is_read_while_the_recording_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "FLUSH_PERIOD_S", 0.01)
    writer = WriterThread(REGISTRY)
    writer.start(RecordingSeries(tmp_path / "run.mcap", REGISTRY, {}, None, 0))
    writer.put(queued())
    wait_until(lambda: len(recorded_messages(tmp_path / "run.mcap")) == 1)
    assert writer.close()


def test_a_disk_that_never_answers_holds_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "CLOSE_TIMEOUT_S", 0.1)
    files = BlockedFiles(tmp_path / "run.mcap")
    writer = WriterThread(REGISTRY)
    writer.start(files)
    writer.put(queued())
    assert not writer.close()
    files.go_on.set()
    wait_until(lambda: writer.ended)
