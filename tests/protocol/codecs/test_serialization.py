"""CDR and ROS 1's serialization, compared with another implementation and with bytes written out by hand."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from protocol.codecs import cdr, ros1_serialization
from protocol.codecs.cbor import packed
from protocol.codecs.cdr import HEADER
from protocol.dialect import declared_in_ros1, to_ros1
from protocol.errors import MessageError
from protocol.messages import Stamp, complete
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY, RosbagsTypes, made_up
from tests.helpers.resources import examples

STORE = get_typestore(Stores.ROS2_JAZZY)
ROSBAGS = RosbagsTypes(STORE, REGISTRY.message)
# rosbags takes no message without fields.
SHARED_TYPES = {name for name in MESSAGE_TYPES if ROSBAGS.has(name) and REGISTRY.message(name).fields}


@examples(5)
@given(seed=st.integers(0, 2**32))
def test_a_message_of_every_type_is_read_back_the_same_from_the_bytes_of_another_implementation(seed: int) -> None:
    assert len(MESSAGE_TYPES) == 340
    assert len(SHARED_TYPES) > 100
    for name in MESSAGE_TYPES:
        message = made_up(REGISTRY, name, seed)
        ours = cdr.serialize(REGISTRY, name, message)
        assert cdr.deserialize(REGISTRY, name, ours) == message, name
        if name in SHARED_TYPES:
            theirs = STORE.serialize_cdr(ROSBAGS.message(name, packed(REGISTRY, name, message, numbers=False)), name)
            # rosbags pads the whole to four bytes.
            assert bytes(theirs) == ours.ljust(len(theirs), b"\0"), name


def test_octets_that_are_no_such_message_are_refused_but_it_may_be_filled_up_to_four() -> None:
    assert cdr.deserialize(REGISTRY, "std_msgs/Bool", HEADER + b"\x01\x00\x00\x00") == {"data": True}
    for name, octets, words in (
        ("std_msgs/Bool", b"\x00\x00\x00\x00\x01", "header 00010000, got 00000000"),
        ("std_msgs/Bool", b"", "got nothing"),
        ("std_msgs/Float64", HEADER + bytes(4), "8 bytes of CDR at byte 0, got 4"),
        ("std_msgs/Bool", HEADER + bytes(5), "1 bytes of std_msgs/Bool, got 4 more"),
        ("std_msgs/String", HEADER + struct.pack("<I", 2**31), "at most 0 elements, got 2147483648"),
        ("std_msgs/String", HEADER + struct.pack("<I", 2) + b"\xff\x00", "text in UTF-8"),
    ):
        with pytest.raises(MessageError, match=words):
            cdr.deserialize(REGISTRY, name, octets)


@examples(200)
@given(octets=st.binary(max_size=60), name=st.sampled_from(["sensor_msgs/JointState", "tf2_msgs/TFMessage"]))
def test_any_octets_are_a_message_or_refused(octets: bytes, name: str) -> None:
    try:
        message = cdr.deserialize(REGISTRY, name, HEADER + octets)
    except MessageError:
        return
    assert list(message) == [field.name for field in REGISTRY.message(name).fields]


ROS1_STORE = get_typestore(Stores.ROS1_NOETIC)
ROS1_BAGS = RosbagsTypes(ROS1_STORE, lambda name: declared_in_ros1(REGISTRY, name))
ROS1_TYPES = [name for name in MESSAGE_TYPES if ROS1_BAGS.has(name)]


@examples(5)
@given(seed=st.integers(0, 2**32))
def test_the_bytes_of_every_shared_type_are_those_of_another_implementation(seed):
    assert len(ROS1_TYPES) > 100
    for name in ROS1_TYPES:
        message = made_up(REGISTRY, name, seed)
        theirs = ROS1_BAGS.message(name, to_ros1(REGISTRY, name, packed(REGISTRY, name, message, numbers=False)))
        wanted = bytes(ROS1_STORE.serialize_ros1(theirs, declared_in_ros1(REGISTRY, name).name))
        assert ros1_serialization.serialize(REGISTRY, name, message) == wanted, name


def test_an_empty_message_has_no_octets_and_types_of_ros2_alone_and_log_records_are_those_of_ros1():
    stamp, octets_of_stamp = {"sec": 1, "nanosec": 2}, bytes.fromhex("01000000 02000000")
    assert ros1_serialization.serialize(REGISTRY, "std_msgs/Empty", {}) == b""
    message = complete(REGISTRY, "action_msgs/GoalInfo", {"stamp": stamp}, Stamp(0, 0))
    assert ros1_serialization.serialize(REGISTRY, "action_msgs/GoalInfo", message) == bytes(16) + octets_of_stamp
    record = complete(REGISTRY, "rcl_interfaces/Log", {"level": 30, "msg": "x", "line": 7}, Stamp(0, 0))
    record_of_ros1 = bytes.fromhex("00000000  04  00000000 01000000 78 00000000 00000000 07000000 00000000")
    octets = ros1_serialization.serialize(REGISTRY, "rcl_interfaces/Log", {**record, "stamp": stamp})
    assert octets == bytes(4) + octets_of_stamp + record_of_ros1
