from __future__ import annotations

import base64
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from server.errors import ConfigurationError
from server.recording import files
from server.recording.files import QOS_KEY, RecordingFile, check_path, is_latched
from tests.server.recordings import REGISTRY, START_NS, entry, record, recorded_messages, text

# One file: what is written is read by the MCAP project's own reader for ROS 2.


def foreign(path: Path) -> list[Any]:
    """Schema, channel, message and what was decoded, of each message."""
    with path.open("rb") as stream:
        return list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())


def test_a_foreign_reader_decodes_what_was_recorded(tmp_path: Path) -> None:
    msgs = [{"name": ["a", "b"], "position": [0.5, float(n)]} for n in range(3)]
    states = [entry("/joint_states", "sensor_msgs/JointState", msg, n) for n, msg in enumerate(msgs)]
    read = foreign(record(tmp_path / "run.mcap", states))
    assert [list(one.decoded_message.position) for one in read] == [msg["position"] for msg in msgs]
    assert read[0].decoded_message.name == ["a", "b"]
    assert [one.message.log_time - START_NS for one in read] == [0, 10**9, 2 * 10**9]
    assert [one.message.sequence for one in read] == [1, 2, 3]


def test_profile_schema_and_channel_are_those_that_viewers_expect(tmp_path: Path) -> None:
    path = record(tmp_path / "run.mcap", [text(0, "/d")._replace(latched=True), entry("/d", "std_msgs/Int8", {}, 1)])
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    schema, channel = summary.schemas[1], summary.channels[1]
    assert (schema.name, schema.encoding, schema.data) == ("std_msgs/msg/String", "ros2msg", b"string data\n")
    assert (channel.topic, channel.message_encoding) == ("/d", "cdr")
    assert is_latched(channel.metadata)
    # A topic with two types has two channels.
    assert [one.schema.name for one in foreign(path)] == ["std_msgs/msg/String", "std_msgs/msg/Int8"]


def test_readers_of_rosbag2_know_which_topics_are_latched(tmp_path: Path) -> None:
    entries = [entry("/plain", "std_msgs/Bool", {}), entry("/kept", "std_msgs/Bool", {"data": True}, 1, latched=True)]
    path = record(tmp_path / "run.mcap", entries)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        offered = {one.topic: cast(Any, one.ext).offered_qos_profiles[0].durability.name for one in reader.connections}
        assert [reader.deserialize(octets, one.msgtype).data for one, _, octets in reader.messages()] == [False, True]
    assert offered == {"/plain": "VOLATILE", "/kept": "TRANSIENT_LOCAL"}


def test_a_foreign_reader_understands_the_schema_of_every_type(tmp_path: Path) -> None:
    # The reader has no wide text.
    wide = {"example_interfaces/msg/WString"}
    names = [name for name in REGISTRY.type_names() if REGISTRY.knows(name) and name not in wide]
    path = record(tmp_path / "run.mcap", [entry(f"/t/{name}", name, {}, n) for n, name in enumerate(names)])
    assert [one.schema.name for one in foreign(path)] == names


# The file.


def test_a_file_that_exists_is_left_alone(tmp_path: Path) -> None:
    for name in ("run.mcap", "run_1.mcap"):
        (tmp_path / name).write_text("precious")
    file = RecordingFile(tmp_path / "run.mcap", REGISTRY)
    file.end()
    assert file.path == tmp_path / "run_2.mcap"
    assert {path.read_bytes() for path in tmp_path.iterdir() if path != file.path} == {b"precious"}


@pytest.mark.parametrize(("limit", "written"), [(20_000, 2), (None, 5)])
def test_a_file_is_full_when_it_has_its_size(tmp_path: Path, limit: int | None, written: int) -> None:
    file = RecordingFile(tmp_path / "run.mcap", REGISTRY, limit)
    for number in range(5):
        if not file.full:
            # A picture of ten kilobytes that does not compress.
            octets = base64.b64encode(random.Random(number).randbytes(10_000)).decode()
            file.add(entry("/picture", "sensor_msgs/CompressedImage", {"format": "", "data": octets}, number))
            file.flush()
    file.end()
    assert len(recorded_messages(file.path)) == written


def test_a_file_with_all_its_channels_is_followed_by_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_CHANNELS", 3)
    record(tmp_path / "run.mcap", [text(number, f"/t{number % 5}") for number in range(7)])
    recorded = [recorded_messages(tmp_path / name) for name in ("run.mcap", "run_1.mcap", "run_2.mcap")]
    assert [[each.topic for each in messages] for messages in recorded] == [
        ["/t0", "/t1", "/t2"],
        ["/t3", "/t4", "/t0"],
        ["/t1"],
    ]


def test_the_size_of_a_recording_is_that_of_all_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_CHANNELS", 1)
    file = RecordingFile(tmp_path / "run.mcap", REGISTRY, 3000)
    for number in range(100):
        if not file.full:
            file.add(text(number, f"/t{number}"))
    file.end()
    sizes = [path.stat().st_size for path in tmp_path.iterdir()]
    assert max(sizes) < 3000 <= sum(sizes) < 3000 + 2 * max(sizes)


def test_a_disk_that_is_full_from_the_beginning_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = Path("/dev/full")
    monkeypatch.setattr(files, "_open_new", lambda _path: (full.open("wb"), full))
    with pytest.raises(OSError, match="No space left"):
        RecordingFile(tmp_path / "run.mcap", REGISTRY)


def test_there_are_only_so_many_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_NUMBER", 1)
    (tmp_path / "run.mcap").touch()
    with pytest.raises(FileExistsError, match="numbered after it exist already"):
        RecordingFile(tmp_path / "run.mcap", REGISTRY)


# Quality of service.


def test_the_numbers_of_older_releases_are_understood() -> None:
    qos = "- history: 1\n  depth: 10\n  durability: "
    assert [is_latched({QOS_KEY: f"{qos}{number}\n"}) for number in (1, 2)] == [True, False]


def test_a_path_of_no_regular_file_in_no_folder_or_too_long_is_refused_and_others_taken(tmp_path: Path) -> None:
    (tmp_path / "file.mcap").touch()
    (tmp_path / "link.mcap").symlink_to(tmp_path / "file.mcap")
    for name in ("file.mcap", "link.mcap", "nothing.mcap"):
        check_path(tmp_path / name)
    made: tuple[Callable[[Path], object], ...] = Path.mkdir, os.mkfifo, lambda path: path.symlink_to("/no/such/file")
    for number, make in enumerate(made):
        make(path := tmp_path / str(number))
        with pytest.raises(ConfigurationError, match=rf"recording\.file: {path} must be a regular file or not exist"):
            check_path(path)
    for folder in ("file.mcap", "no"):
        words = f"cannot be written: there is no writable folder .*/{folder}"
        with pytest.raises(ConfigurationError, match=rf"{folder}/run\.mcap {words}"):
            check_path(tmp_path / folder / "run.mcap")
    with pytest.raises(ConfigurationError, match=r"recording\.file: .* cannot be used: File name too long"):
        check_path(tmp_path / ("x" * 300))
