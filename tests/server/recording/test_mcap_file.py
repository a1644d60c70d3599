"""What is written is read by the MCAP project's own reader for ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from server.recording.mcap_file import FACTS, McapFile
from server.recording.qos import is_latched
from tests.helpers.recorded import REGISTRY, START_NS, entry, record


def foreign(path: Path) -> list[Any]:
    """Schema, channel, message and what was decoded, of each message."""
    with path.open("rb") as stream:
        return list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())


def test_a_foreign_reader_decodes_what_was_recorded(tmp_path: Path) -> None:
    states = [
        entry("/joint_states", "sensor_msgs/JointState", {"name": ["a", "b"], "position": [0.5, float(n)]}, n)
        for n in range(3)
    ]
    read = foreign(record(tmp_path / "run.mcap", states))
    assert [list(one.decoded_message.position) for one in read] == [[0.5, 0.0], [0.5, 1.0], [0.5, 2.0]]
    assert read[0].decoded_message.name == ["a", "b"]
    assert [one.message.log_time - START_NS for one in read] == [0, 10**9, 2 * 10**9]
    assert [one.message.sequence for one in read] == [1, 2, 3]


def test_a_foreign_reader_understands_the_schema_of_every_type(tmp_path: Path) -> None:
    names = [name for name in REGISTRY.type_names() if REGISTRY.knows(name)]
    path = record(tmp_path / "run.mcap", [entry(f"/t/{name}", name, {}, n) for n, name in enumerate(names)])
    assert [one.schema.name for one in foreign(path)] == names


def test_profile_schema_and_channel_are_those_that_viewers_expect(tmp_path: Path) -> None:
    path = record(tmp_path / "run.mcap", [entry("/d", "std_msgs/String", {"data": "<robot/>"}, latched=True)])
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    schema, channel = summary.schemas[1], summary.channels[1]
    assert (schema.name, schema.encoding, schema.data) == ("std_msgs/msg/String", "ros2msg", b"string data\n")
    assert (channel.topic, channel.message_encoding) == ("/d", "cdr")
    assert is_latched(channel.metadata)


def test_readers_of_rosbag2_know_which_topics_are_latched(tmp_path: Path) -> None:
    entries = [
        entry("/plain", "std_msgs/Bool", {}),
        entry("/latched", "std_msgs/Bool", {"data": True}, 1, latched=True),
    ]
    path = record(tmp_path / "run.mcap", entries)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        offered = {one.topic: cast(Any, one.ext).offered_qos_profiles[0].durability.name for one in reader.connections}
        assert [reader.deserialize(octets, one.msgtype).data for one, _, octets in reader.messages()] == [False, True]
    assert offered == {"/plain": "VOLATILE", "/latched": "TRANSIENT_LOCAL"}


def test_facts_are_kept_as_metadata(tmp_path: Path) -> None:
    McapFile((tmp_path / "run.mcap").open("wb"), REGISTRY, {"robot": "so101"}).end({"dropped_messages": "3"})
    with (tmp_path / "run.mcap").open("rb") as stream:
        first, last = (each.metadata for each in make_reader(stream).iter_metadata() if each.name == FACTS)
    assert (first["robot"], last["dropped_messages"]) == ("so101", "3")


def test_a_topic_with_two_types_has_two_channels(tmp_path: Path) -> None:
    entries = [entry("/t", "std_msgs/Bool", {}), entry("/t", "std_msgs/Int8", {}, 1)]
    read = foreign(record(tmp_path / "run.mcap", entries))
    assert [one.schema.name for one in read] == ["std_msgs/msg/Bool", "std_msgs/msg/Int8"]
