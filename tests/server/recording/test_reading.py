from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from server.errors import RecordingError
from server.recording import reading
from server.recording.reading import messages
from tests.server.recordings import START_NS, record_killed, recorded_messages, text

CHUNKS = [[text(0), text(1)], [text(2), text(3)], [text(4)]]


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


def write_other(path: Path, octets: Sequence[bytes], compression: CompressionType, *, chunks: bool = True) -> Path:
    """Write texts as another program does."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, use_chunking=chunks)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/t", "cdr", schema)
        for number, each in enumerate(octets):
            writer.add_message(channel, START_NS + number, each, START_NS)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunks", [True, False])
def test_files_of_other_writers_are_read(tmp_path: Path, compression: CompressionType, chunks: bool) -> None:
    octets = [text(number).octets for number in range(3)]
    file = write_other(tmp_path / "other.mcap", octets, compression, chunks=chunks)
    assert [each.octets for each in recorded_messages(file)] == octets


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_that_unpacks_to_more_than_a_record_may_have_is_damage(
    tmp_path: Path,
    compression: CompressionType,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(reading, "MAX_RECORD_BYTES", 100_000)
    file = write_other(tmp_path / "other.mcap", [bytes(100_001)], compression)
    assert file.stat().st_size < 10_000
    assert recorded_messages(file) == []
    assert "what comes after the last readable chunk is left out" in caplog.text


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path.write_bytes(b"a text that is longer than eight characters"), "is not an MCAP file"),
        (Path.touch, "is not an MCAP file"),
        (lambda _path: None, "cannot be read: No such file"),
    ],
    ids=["text", "an empty file", "no file"],
)
def test_an_invalid_recording_is_refused_in_words(tmp_path: Path, make: Callable[[Path], object], words: str) -> None:
    make(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match=rf"run\.mcap: {words}"):
        recorded_messages(tmp_path / "run.mcap")


BAG = "rosbag2_bagfile_information"
BAGS = [
    ({}, "run: has no metadata.yaml; ros2 bag reindex writes it"),
    ({"metadata.yaml": "- 1"}, "run: metadata.yaml does not describe the files of a bag"),
    ({"metadata.yaml": "{"}, "run: metadata.yaml does not describe the files of a bag"),
    ({"metadata.yaml": f"{BAG}: {{compression_mode: FILE, relative_file_paths: []}}"}, "run: is compressed"),
    ({"metadata.yaml": f"{BAG}: {{relative_file_paths: [../../a.db3]}}"}, "run/a.db3: cannot be read: No such"),
    (
        {"metadata.yaml": f"{BAG}: {{relative_file_paths: [a.db3]}}", "a.db3": "text of no database, at length"},
        "run/a.db3: is no SQLite file of rosbag2: file is not a database",
    ),
]


@pytest.mark.parametrize(("files", "sentence"), BAGS)
def test_a_bag_that_cannot_be_read_is_refused(files: dict[str, str], sentence: str, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    for name, content in files.items():
        (tmp_path / "run" / name).write_text(content)
    with pytest.raises(RecordingError, match=sentence):
        list(messages(tmp_path / "run"))
