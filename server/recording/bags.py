"""Recordings of any kind as messages: MCAP files, and bags of rosbag2, which are folders of MCAP or SQLite files.

rosbag2 (ros2/rosbag2, README.md "Storage format plugin architecture") describes a bag in its ``metadata.yaml``.
"""

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from server.errors import RecordingError
from server.recording.files import QOS_KEY, RecordedMessage, is_latched
from server.recording.replay import RecordingFile

METADATA_FILE = "metadata.yaml"
SQLITE = ".db3"

_MESSAGES = (
    "SELECT name, type, offered_qos_profiles, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
    " WHERE serialization_format = 'cdr' ORDER BY timestamp"
)


def messages(path: Path) -> Iterator[RecordedMessage]:
    """Yield the messages of a file or bag in their order; raises RecordingError."""
    for file in _files(path) if path.is_dir() else [path]:
        if file.suffix == SQLITE:
            if not file.is_file():
                raise RecordingError(file, "cannot be read: No such file")
            try:
                with contextlib.closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
                    for topic, type_name, qos, log_time_ns, octets in database.execute(_MESSAGES):
                        latched = is_latched({QOS_KEY: str(qos)})
                        yield RecordedMessage(topic, type_name, latched, log_time_ns, log_time_ns, octets)
            except sqlite3.Error as error:
                raise RecordingError(file, f"is no SQLite file of rosbag2: {error}") from error
        else:
            yield from RecordingFile(file).messages()


def _files(bag: Path) -> list[Path]:
    try:
        described: Any = yaml.safe_load((bag / METADATA_FILE).read_text())["rosbag2_bagfile_information"]
        # Early releases name the folder as well.
        files = [bag / Path(name).name for name in described["relative_file_paths"]]
    except FileNotFoundError as error:
        raise RecordingError(bag, f"has no {METADATA_FILE}; ros2 bag reindex writes it") from error
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError) as error:
        raise RecordingError(bag, f"{METADATA_FILE} does not describe the files of a bag") from error
    if described.get("compression_mode"):
        raise RecordingError(bag, "is compressed by rosbag2; ros2 bag convert writes it without compression")
    return files
