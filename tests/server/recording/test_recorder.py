from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from protocol.codecs.cdr import deserialize
from server.errors import StartError
from server.graph.node import Node
from server.graph.topics import Graph
from server.recording import writer_thread
from server.recording.mcap_file import Entry
from server.recording.reader import Recording
from server.recording.recorder import Recorder
from tests.helpers.recorded import REGISTRY

TALKER = Node("talker")


@pytest.fixture
def graph() -> Graph:
    return Graph(REGISTRY, relay_unknown_types=True)


async def recorded(graph: Graph, path: Path, publish: Callable[[], None]) -> list[Entry]:
    """What is in the file after something was published."""
    recorder = Recorder(graph, path)
    recorder.open()
    publish()
    await recorder.close()
    return [each for chunk in Recording(path).entries() for each in chunk]


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
        graph, tmp_path / "run.mcap", clock_ns=lambda: next(monotonic_ns), wall_clock_ns=lambda: 1_000_005
    )
    recorder.open()
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    graph.publish(TALKER, "/a", {})
    await recorder.close()
    entries = [each for chunk in Recording(tmp_path / "run.mcap").entries() for each in chunk]
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


async def test_it_tells_whether_it_records_and_what_waits(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_thread, "LOOK_PERIOD_S", 60.0)
    recorder = Recorder(graph, tmp_path / "run.mcap")
    assert recorder.ended
    recorder.open()
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
    assert [each for chunk in Recording(tmp_path / "run.mcap").entries() for each in chunk] == []


def test_a_file_that_cannot_be_written_is_refused_with_its_name(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(StartError, match=r"recording\.file: .*nowhere/run\.mcap cannot be written: No such file"):
        Recorder(graph, tmp_path / "nowhere" / "run.mcap").open()
