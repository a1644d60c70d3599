from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from server.errors import RecordingError
from server.recording import reader
from server.recording.files import RecordedMessage
from server.recording.reader import RecordedTopic, Recording
from tests.helpers.recorded import START_NS, record, record_killed, text

CHUNKS = [[text(0), text(1)], [text(2), text(3)], [text(4)]]


def entries(path: Path) -> list[RecordedMessage]:
    return [each for chunk in Recording(path).chunks() for each in chunk]


def test_what_was_recorded_is_read_back(tmp_path: Path) -> None:
    written = [text(0), text(1, "/latched")._replace(latched=True)]
    assert entries(record(tmp_path / "run.mcap", written)) == written


def test_the_summary_tells_topics_count_and_length(tmp_path: Path) -> None:
    summary = Recording(record(tmp_path / "run.mcap", map(text, range(4)))).summary()
    assert summary.topics == [RecordedTopic("/t", "std_msgs/msg/String", False)]
    assert (summary.messages, summary.duration_s, summary.complete) == (4, 3.0, True)


def test_the_recording_of_a_killed_server_is_read_to_its_last_chunk(tmp_path: Path) -> None:
    path = record_killed(tmp_path / "run.mcap", CHUNKS)
    summary = Recording(path).summary()
    assert (summary.messages, summary.duration_s, summary.complete) == (5, 4.0, False)
    assert [track.topic for track in summary.topics] == ["/t"]


def test_a_file_cut_anywhere_is_read_as_far_as_its_whole_chunks_go(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    octets = record_killed(tmp_path / "run.mcap", CHUNKS).read_bytes()
    counts = []
    for length in range(10, len(octets), 7):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(octets[:length])
        try:
            counts.append(len(entries(cut)))
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
    assert len(entries(tmp_path / "run.mcap")) == 2


def test_a_chunk_that_claims_to_be_huge_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(tmp_path / "run.mcap", [text(0)._replace(octets=bytes(50_000))])
    monkeypatch.setattr(reader, "MAX_RECORD_BYTES", 10_000)
    assert entries(path) == []


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
    assert [each.octets for each in entries(tmp_path / "other.mcap")] == [text(number).octets for number in range(3)]


def test_a_file_without_messages_of_ros_2_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/t", "json", 0), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(RecordingError, match="no messages of ROS 2: /t is encoded as 'json', not 'cdr'"):
        Recording(tmp_path / "other.mcap").summary()


NO_RECORDINGS = {
    "text": (b"a text that is longer than eight characters", "is not an MCAP file"),
    "nothing": (b"", "is not an MCAP file"),
    "magic alone": (b"\x89MCAP0\r\n", "is not an MCAP file"),
}


@pytest.mark.parametrize(("octets", "words"), NO_RECORDINGS.values(), ids=NO_RECORDINGS.keys())
def test_what_is_no_recording_is_refused_with_a_sentence(tmp_path: Path, octets: bytes, words: str) -> None:
    (tmp_path / "run.mcap").write_bytes(octets)
    with pytest.raises(RecordingError, match=rf"run\.mcap: {words}"):
        Recording(tmp_path / "run.mcap").summary()


def test_a_file_that_is_not_there_is_refused_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"run\.mcap: cannot be read: No such file"):
        Recording(tmp_path / "run.mcap").summary()


def test_a_recording_of_nothing_is_refused_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="has no messages of ROS 2"):
        Recording(record(tmp_path / "run.mcap", [])).summary()
