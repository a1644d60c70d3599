from __future__ import annotations

import base64
import random
from pathlib import Path

import pytest

from server.recording import file_series
from server.recording.file_series import FileSeries
from server.recording.mcap_file import Entry
from server.recording.reader import Recording
from tests.helpers.recorded import REGISTRY, entry, text

LIMIT = 20_000


def series(path: Path, limit: int | None = LIMIT, keep: int = 0) -> FileSeries:
    return FileSeries(path, REGISTRY, {}, limit, keep)


def picture(number: int) -> Entry:
    """Ten kilobytes that do not compress."""
    octets = base64.b64encode(random.Random(number).randbytes(10_000)).decode()
    return entry("/picture", "sensor_msgs/CompressedImage", {"format": str(number), "data": octets}, number)


def fill(files: FileSeries, count: int) -> None:
    for number in range(count):
        files.add(picture(number))
        files.flush()
    files.end({})


def topics(path: Path) -> list[str]:
    return [each.topic for chunk in Recording(path).entries() for each in chunk]


def names(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


def test_a_file_that_exists_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("precious")
    files = series(tmp_path / "run.mcap")
    files.end({})
    assert files.path == tmp_path / "run_1.mcap"
    assert (tmp_path / "run.mcap").read_text() == "precious"


def test_a_file_that_has_its_size_is_followed_by_the_next(tmp_path: Path) -> None:
    fill(series(tmp_path / "run.mcap"), 5)
    assert names(tmp_path) == ["run.mcap", "run_1.mcap", "run_2.mcap"]
    assert [len(topics(tmp_path / name)) for name in names(tmp_path)] == [2, 2, 1]


def test_without_a_limit_there_is_one_file(tmp_path: Path) -> None:
    fill(series(tmp_path / "run.mcap", limit=None), 5)
    assert names(tmp_path) == ["run.mcap"]


def test_the_oldest_files_of_the_series_are_given_up(tmp_path: Path) -> None:
    (tmp_path / "other.mcap").touch()
    fill(series(tmp_path / "run.mcap", keep=2), 7)
    assert names(tmp_path) == ["other.mcap", "run_2.mcap", "run_3.mcap"]


def test_what_is_latched_stands_at_the_beginning_of_every_file(tmp_path: Path) -> None:
    files = series(tmp_path / "run.mcap")
    files.add(entry("/robot_description", "std_msgs/String", {"data": "<robot/>"}, latched=True))
    fill(files, 3)
    assert topics(tmp_path / "run_1.mcap") == ["/robot_description", "/picture"]


def test_only_so_much_that_is_latched_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_series, "MAX_LATCHED_BYTES", 15)
    files = series(tmp_path / "run.mcap")
    files.add(text(1, "/small")._replace(latched=True))
    files.add(text(1, "/one_too_many")._replace(latched=True))
    fill(files, 3)
    assert topics(tmp_path / "run_1.mcap") == ["/small", "/picture"]


def test_a_disk_that_is_full_from_the_beginning_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = Path("/dev/full")
    monkeypatch.setattr(FileSeries, "_open_next", lambda _files: (full.open("wb"), full))
    with pytest.raises(OSError, match="No space left"):
        series(tmp_path / "run.mcap")


def test_there_are_only_so_many_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_series, "MAX_NUMBER", 1)
    (tmp_path / "run.mcap").touch()
    with pytest.raises(FileExistsError, match="numbered after it exist already"):
        series(tmp_path / "run.mcap")
