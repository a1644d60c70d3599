"""Bags of rosbag2 that cannot be read; tests/server/datasets/test_export.py reads bags of another writer."""

from pathlib import Path

import pytest

from server.errors import RecordingError
from server.recording.bags import messages

BAD_BAGS = {
    "no description": ({}, "run: has no metadata.yaml; ros2 bag reindex writes it"),
    "no bag": ({"metadata.yaml": "- 1"}, "run: metadata.yaml does not describe the files of a bag"),
    "no YAML": ({"metadata.yaml": "{"}, "run: metadata.yaml does not describe the files of a bag"),
    "compressed": ({"metadata.yaml": "{compression_mode: FILE, relative_file_paths: []}"}, "run: is compressed"),
    "a file outside": ({"metadata.yaml": "{relative_file_paths: [../../a.db3]}"}, "run/a.db3: cannot be read: No such"),
    "no database": (
        {"metadata.yaml": "{relative_file_paths: [a.db3]}", "a.db3": "text of no database, at length"},
        "run/a.db3: is no SQLite file of rosbag2: file is not a database",
    ),
}


@pytest.mark.parametrize(("files", "sentence"), BAD_BAGS.values(), ids=BAD_BAGS.keys())
def test_a_bag_that_cannot_be_read_is_refused_with_a_sentence(
    files: dict[str, str], sentence: str, tmp_path: Path
) -> None:
    (tmp_path / "run").mkdir()
    for name, text in files.items():
        described = text.startswith("{") and len(text) > 1
        (tmp_path / "run" / name).write_text(f"rosbag2_bagfile_information: {text}" if described else text)
    with pytest.raises(RecordingError, match=sentence):
        list(messages(tmp_path / "run"))
