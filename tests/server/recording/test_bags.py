"""Bags of rosbag2 that cannot be read; tests/server/datasets/test_export.py reads bags of another writer."""

from pathlib import Path

import pytest

from server.errors import RecordingError
from server.recording.bags import messages

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
    for name, text in files.items():
        (tmp_path / "run" / name).write_text(text)
    with pytest.raises(RecordingError, match=sentence):
        list(messages(tmp_path / "run"))
