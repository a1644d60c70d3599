from __future__ import annotations

import logging
import threading
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
from tests.server.recordings import REGISTRY, recorded_messages

TALKER = Node("talker")


@pytest.fixture
def graph() -> Graph:
    return Graph(REGISTRY, relay_unknown_types=True)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


async def test_all_of_every_topic_is_recorded_with_nobody_listening_and_unknown_types_are_left_out(
    graph: Graph, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    recorder = Recorder(graph, tmp_path / "run.mcap", RecordingSettings())
    graph.advertise(TALKER, "/a", "std_msgs/String")
    graph.publish(TALKER, "/a", {"data": "x"})
    assert not (tmp_path / "run.mcap").exists()
    recorder.start()
    graph.advertise(TALKER, "/b", "geometry_msgs/Point", latch=True)
    graph.publish(TALKER, "/b", {"x": 1.5})
    graph.advertise(TALKER, "/own", "my_msgs/Thing")
    for number in (1, 2):
        graph.publish(TALKER, "/own", {"a": number})
    await recorder.close()
    assert graph._watchers == ()
    graph.publish(TALKER, "/a", {"data": "too late"})
    a, b = recorded_messages(tmp_path / "run.mcap")
    assert (a.topic, a.latched, b.topic, b.latched) == ("/a", False, "/b", True)
    assert deserialize(REGISTRY, b.type_name, b.octets) == {"x": 1.5, "y": 0.0, "z": 0.0}
    told = [line for line in caplog.messages if "left out" in line]
    assert told == ["recording: /own is left out, the type my_msgs/msg/Thing is unknown"]


async def test_times_do_not_jump_with_the_wall_clock(graph: Graph, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "POLL_PERIOD_S", 60.0)
    clocks = {"clock_ns": iter([5, 7, 9]).__next__, "wall_clock_ns": lambda: 1_000_005}
    recorder = Recorder(graph, run, RecordingSettings(), **clocks)
    recorder.start()
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    graph.publish(TALKER, "/a", {})
    assert (recorder.ended, recorder.queued) == (False, 2)
    await recorder.close()
    assert (recorder.ended, recorder.queued) == (True, 0)
    assert [each.log_time_ns for each in recorded_messages(run)] == [1_000_007, 1_000_009]


def test_a_file_that_cannot_be_written_is_refused_with_its_name(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(StartError, match=r"recording\.file: .*nowhere/run\.mcap cannot be written: No such file"):
        Recorder(graph, tmp_path / "nowhere" / "run.mcap", RecordingSettings()).start()


# The thread.


class BlockedFiles(RecordingSeries):
    """Files on a disk that stands still until it is let go."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, REGISTRY, {}, None, 0)
        self.reached, self.go_on = threading.Event(), threading.Event()

    def add(self, entry: RecordedMessage) -> None:
        self.reached.set()
        assert self.go_on.wait(TIMEOUT_S)
        super().add(entry)


class FullDisk(RecordingSeries):
    """Files on a disk that has no room any more; the errors are the system's."""

    def add(self, entry: RecordedMessage) -> None:
        with Path("/dev/full").open("wb", buffering=0) as full:
            full.write(entry.octets)


def writing(files: RecordingSeries, count: int) -> WriterThread:
    """Start a thread that writes messages."""
    writer = WriterThread(REGISTRY)
    writer.start(files)
    for number in range(count):
        writer.put(queued(number))
    return writer


def queued(number: int) -> QueuedMessage:
    stamp = Stamp(7, 5)
    msg = complete(REGISTRY, "std_msgs/msg/String", {"data": str(number)}, stamp)
    published = PublishedMessage("/t", "std_msgs/msg/String", msg, REGISTRY, stamp)
    return QueuedMessage(published, False, 20, 1000 + number)


def test_queued_messages_are_in_the_file_in_order_and_soon(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "FLUSH_PERIOD_S", 0.01)
    writer = writing(RecordingSeries(run, REGISTRY, {}, None, 0), 100)
    wait_until(lambda: len(recorded_messages(run)) == 100)
    assert writer.close()
    entries = recorded_messages(run)
    assert [each.log_time_ns for each in entries] == list(range(1000, 1100))
    assert {each.publish_time_ns for each in entries} == {7_000_000_005}


@pytest.mark.parametrize(("limit", "value"), [("MAX_QUEUED_MESSAGES", 3), ("MAX_QUEUED_BYTES", 80)])
def test_a_disk_that_stands_still_costs_messages_and_not_memory(
    limit: str, value: int, run: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, limit, value)
    files = BlockedFiles(run)
    writer = writing(files, 1)
    assert files.reached.wait(TIMEOUT_S)
    for number in range(1, 11):
        writer.put(queued(number))
    assert (writer.dropped, writer.queued) == (7, 3)
    files.go_on.set()
    assert writer.close()
    assert "7 messages were dropped" in caplog.text
    assert len(recorded_messages(run)) == 4


def test_a_full_disk_ends_the_recording_with_one_line(run: Path, caplog: pytest.LogCaptureFixture) -> None:
    writer = writing(FullDisk(run, REGISTRY, {}, None, 0), 10)
    wait_until(lambda: writer.ended)
    assert writer.close()
    errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert errors == [f"recording ended: {run} cannot be written any further: No space left on device"]


def test_a_disk_that_never_answers_holds_nobody_up(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "CLOSE_TIMEOUT_S", 0.1)
    files = BlockedFiles(run)
    writer = writing(files, 1)
    assert not writer.close()
    files.go_on.set()
    wait_until(lambda: writer.ended)
