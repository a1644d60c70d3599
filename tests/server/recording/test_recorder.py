from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S, wait_until
from protocol.codecs.cdr import deserialize
from server.config import RecordingSettings
from server.errors import StartError
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.recording import recorder as recorder_module
from server.recording.files import RecordedMessage, RecordingFile
from server.recording.recorder import Recorder
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


@pytest.mark.parametrize("clock", [None, iter([1.5, 2.5]).__next__])
async def test_times_are_those_of_a_steady_clock_or_of_the_simulation(
    graph: Graph, run: Path, monkeypatch: pytest.MonkeyPatch, clock: Callable[[], float] | None
) -> None:
    steady = iter([500_000_000, 1_500_000_000, 2_500_000_000])
    monkeypatch.setattr(recorder_module, "POLL_PERIOD_S", 60.0)
    monkeypatch.setattr(recorder_module.time, "monotonic_ns", steady.__next__)
    monkeypatch.setattr(recorder_module.time, "time_ns", iter([500_000_000]).__next__)
    recorder = Recorder(graph, run, RecordingSettings(), clock=clock)
    recorder.start()
    talk(graph, 2)
    assert not recorder.ended
    await recorder.close()
    assert recorder.ended
    assert [each.log_time_ns for each in recorded_messages(run)] == [1_500_000_000, 2_500_000_000]


def test_a_file_that_cannot_be_written_is_refused_with_its_name(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(StartError, match=r"recording\.file: .*nowhere/run\.mcap cannot be written: No such file"):
        Recorder(graph, tmp_path / "nowhere" / "run.mcap", RecordingSettings()).start()


# The thread.


class BlockedFile(RecordingFile):
    """File on a disk that stands still until it is let go."""

    reached, go_on = threading.Event(), threading.Event()

    def add(self, entry: RecordedMessage) -> None:
        self.reached.set()
        assert self.go_on.wait(TIMEOUT_S)
        super().add(entry)


class FullDisk(RecordingFile):
    """File on a disk that has no room any more; the errors are the system's."""

    def add(self, entry: RecordedMessage) -> None:
        with Path("/dev/full").open("wb", buffering=0) as full:
            full.write(entry.octets)


class FullFile(RecordingFile):
    """File that is full with two messages."""

    @property
    def full(self) -> bool:
        return sum(count for _, count in self._channels.values()) == 2


def talk(graph: Graph, count: int) -> None:
    """Publish messages."""
    graph.advertise(TALKER, "/t", "std_msgs/String")
    for number in range(count):
        graph.publish(TALKER, "/t", {"data": str(number)})


Start = Callable[..., Recorder]


@pytest.fixture
def recording(graph: Graph, run: Path, monkeypatch: pytest.MonkeyPatch) -> Start:
    """Starts a recorder that writes messages to a file of a class."""
    for event in (BlockedFile.reached, BlockedFile.go_on):
        event.clear()

    def start(count: int, file: type[RecordingFile] = RecordingFile) -> Recorder:
        monkeypatch.setattr(recorder_module, "RecordingFile", file)
        recorder = Recorder(graph, run, RecordingSettings())
        recorder.start()
        talk(graph, count)
        return recorder

    return start


async def test_queued_messages_are_soon_written(recording: Start, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "FLUSH_PERIOD_S", 0.01)
    recorder = recording(100)
    wait_until(lambda: len(recorded_messages(run)) == 100)
    await recorder.close()
    read = [deserialize(REGISTRY, each.type_name, each.octets) for each in recorded_messages(run)]
    assert read == [{"data": str(number)} for number in range(100)]


# A message has 12 bytes as JSON.
@pytest.mark.parametrize(("limit", "value"), [("MAX_QUEUED_MESSAGES", 3), ("MAX_QUEUED_BYTES", 48)])
async def test_a_disk_that_stands_still_costs_messages_and_not_memory(
    limit: str, value: int, graph: Graph, recording: Start, run: Path, monkeypatch: Any, caplog: Any
) -> None:
    monkeypatch.setattr(recorder_module, limit, value)
    recorder = recording(1, BlockedFile)
    assert BlockedFile.reached.wait(TIMEOUT_S)
    talk(graph, 10)
    assert recorder.dropped == 7
    BlockedFile.go_on.set()
    await recorder.close()
    assert "7 messages were dropped" in caplog.text
    assert len(recorded_messages(run)) == 4


async def test_a_full_disk_ends_the_recording_with_one_line(recording: Start, run: Path, caplog: Any) -> None:
    recorder = recording(10, FullDisk)
    wait_until(lambda: recorder.ended)
    await recorder.close()
    errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert errors == [f"recording ended: {run} cannot be written any further: No space left on device"]


async def test_a_recording_that_has_its_size_ends_whole_with_a_line(recording: Start, run: Path, caplog: Any) -> None:
    recorder = recording(10, FullFile)
    wait_until(lambda: recorder.ended)
    await recorder.close()
    assert f"recording: {run} has the size of recording.limit_mb" in caplog.text
    assert [deserialize(REGISTRY, each.type_name, each.octets)["data"] for each in recorded_messages(run)] == ["0", "1"]


async def test_a_disk_that_never_answers_holds_nobody_up(recording: Start, monkeypatch: Any, caplog: Any) -> None:
    monkeypatch.setattr(recorder_module, "CLOSE_TIMEOUT_S", 0.1)
    recorder = recording(1, BlockedFile)
    await recorder.close()
    assert "run.mcap was not ended within 0.1 s; its content can be read" in caplog.text
    BlockedFile.go_on.set()
    wait_until(lambda: recorder.ended)
