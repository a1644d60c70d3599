from __future__ import annotations

import logging
import threading
from pathlib import Path

import pytest

from protocol.messages import Stamp, complete
from protocol.publication import Publication
from server.recording import writer_thread
from server.recording.file_series import FileSeries
from server.recording.mcap_file import Entry
from server.recording.reader import Recording
from server.recording.writer_thread import Taken, WriterThread
from tests.helpers.recorded import REGISTRY, wait_until


class BlockedFiles(FileSeries):
    """Files on a disk that stands still until it is let go."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, REGISTRY, {}, None, 0)
        self.reached = threading.Event()
        self.go_on = threading.Event()

    def add(self, entry: Entry) -> None:
        self.reached.set()
        assert self.go_on.wait(5.0)
        super().add(entry)


class FullDisk(FileSeries):
    """Files on a disk that has no room any more; the errors are the system's."""

    def add(self, entry: Entry) -> None:
        with Path("/dev/full").open("wb", buffering=0) as full:
            full.write(entry.octets)


def taken(number: int = 0, size_bytes: int = 20) -> Taken:
    stamp = Stamp(7, 5)
    msg = complete(REGISTRY, "std_msgs/msg/String", {"data": str(number)}, stamp)
    return Taken(Publication("/t", "std_msgs/msg/String", msg, REGISTRY, stamp), False, size_bytes, 1000 + number)


def read(path: Path) -> list[Entry]:
    return [each for chunk in Recording(path).entries() for each in chunk]


def test_what_is_put_is_in_the_file_in_order(tmp_path: Path) -> None:
    writer = WriterThread(FileSeries(tmp_path / "run.mcap", REGISTRY, {}, None, 0), REGISTRY)
    writer.start()
    for number in range(100):
        writer.put(taken(number))
    assert writer.close()
    entries = read(tmp_path / "run.mcap")
    assert [each.log_time_ns for each in entries] == list(range(1000, 1100))
    assert {each.publish_time_ns for each in entries} == {7_000_000_005}


@pytest.mark.parametrize(
    ("limit", "value"), [("MAX_QUEUED_MESSAGES", 3), ("MAX_QUEUED_BYTES", 80)], ids=["messages", "bytes"]
)
def test_a_disk_that_stands_still_costs_messages_and_not_memory(
    limit: str, value: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(writer_thread, limit, value)
    files = BlockedFiles(tmp_path / "run.mcap")
    writer = WriterThread(files, REGISTRY)
    writer.start()
    writer.put(taken())
    assert files.reached.wait(5.0)
    for number in range(1, 11):
        writer.put(taken(number))
    assert (writer.dropped, writer.queued) == (7, 3)
    files.go_on.set()
    assert writer.close()
    assert "7 messages were dropped" in caplog.text
    assert len(read(tmp_path / "run.mcap")) == 4


def test_a_full_disk_ends_the_recording_with_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    writer = WriterThread(FullDisk(tmp_path / "run.mcap", REGISTRY, {}, None, 0), REGISTRY)
    writer.start()
    for number in range(10):
        writer.put(taken(number))
    assert wait_until(lambda: writer.ended)
    assert writer.close()
    errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert errors == [
        f"recording ended: {tmp_path / 'run.mcap'} cannot be written any further: No space left on device"
    ]


def test_what_was_put_a_moment_ago_can_be_read_while_the_recording_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_thread, "FLUSH_PERIOD_S", 0.01)
    writer = WriterThread(FileSeries(tmp_path / "run.mcap", REGISTRY, {}, None, 0), REGISTRY)
    writer.start()
    writer.put(taken())
    assert wait_until(lambda: len(read(tmp_path / "run.mcap")) == 1)
    assert writer.close()


def test_a_disk_that_never_answers_holds_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_thread, "CLOSE_TIMEOUT_S", 0.1)
    files = BlockedFiles(tmp_path / "run.mcap")
    writer = WriterThread(files, REGISTRY)
    writer.start()
    writer.put(taken())
    assert not writer.close()
    files.go_on.set()
    assert wait_until(lambda: writer.ended)
