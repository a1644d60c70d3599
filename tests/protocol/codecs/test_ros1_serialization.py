"""ROS 1's serialization, compared with another implementation and with bytes written out by hand."""

from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from protocol.codecs.cbor import packed
from protocol.codecs.cdr import serialize_for_ros1
from protocol.dialect import declared_in_ros1, to_ros1
from protocol.messages import Stamp, complete
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY, RosbagsTypes, made_up
from tests.helpers.resources import examples

STORE = get_typestore(Stores.ROS1_NOETIC)
ROSBAGS = RosbagsTypes(STORE, lambda name: declared_in_ros1(REGISTRY, name))
SHARED_TYPES = [name for name in MESSAGE_TYPES if ROSBAGS.has(name)]


@examples(5)
@given(seed=st.integers(0, 2**32))
def test_the_bytes_of_every_shared_type_are_those_of_another_implementation(seed):
    assert len(SHARED_TYPES) > 100
    for name in SHARED_TYPES:
        message = made_up(REGISTRY, name, seed)
        theirs = ROSBAGS.message(name, to_ros1(REGISTRY, name, packed(REGISTRY, name, message, numbers=False)))
        wanted = bytes(STORE.serialize_ros1(theirs, declared_in_ros1(REGISTRY, name).name))
        assert serialize_for_ros1(REGISTRY, name, message) == wanted, name


def test_an_empty_message_has_no_octets_and_types_of_ros2_alone_and_log_records_are_those_of_ros1():
    stamp, octets_of_stamp = {"sec": 1, "nanosec": 2}, bytes.fromhex("01000000 02000000")
    assert serialize_for_ros1(REGISTRY, "std_msgs/Empty", {}) == b""
    message = complete(REGISTRY, "action_msgs/GoalInfo", {"stamp": stamp}, Stamp(0, 0))
    assert serialize_for_ros1(REGISTRY, "action_msgs/GoalInfo", message) == bytes(16) + octets_of_stamp
    record = complete(REGISTRY, "rcl_interfaces/Log", {"level": 30, "msg": "x", "line": 7}, Stamp(0, 0))
    record_of_ros1 = bytes.fromhex("00000000  04  00000000 01000000 78 00000000 00000000 07000000 00000000")
    octets = serialize_for_ros1(REGISTRY, "rcl_interfaces/Log", {**record, "stamp": stamp})
    assert octets == bytes(4) + octets_of_stamp + record_of_ros1
