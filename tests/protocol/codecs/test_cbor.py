import math
import struct

import cbor2
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import cbor
from protocol.messages import Stamp, complete
from tests.helpers.messages import REGISTRY

# rosbridge's tags (cbor_conversion.py) and the formats of one element.
TAGS = {
    "UInt16": (69, "H"),
    "UInt32": (70, "I"),
    "UInt64": (71, "Q"),
    "Byte": (72, "b"),
    "Int8": (72, "b"),
    "Int16": (77, "h"),
    "Int32": (78, "i"),
    "Int64": (79, "q"),
    "Float32": (85, "f"),
    "Float64": (86, "d"),
}


def completed_and_packed(type_name, msg, *, numbers):
    message = complete(REGISTRY, type_name, msg, Stamp(1, 2))
    return message, cbor.packed(REGISTRY, type_name, message, numbers=numbers)


def test_numbers_become_a_typed_array_of_their_tag_little_endian():
    for name, (tag, code) in TAGS.items():
        _, packed = completed_and_packed(f"std_msgs/{name}MultiArray", {"data": [1, 2, 100]}, numbers=True)
        assert packed["data"] == cbor2.CBORTag(tag, struct.pack(f"<3{code}", 1, 2, 100))


def test_base64_text_becomes_octets_at_any_depth_and_octets_alone_leave_lists_of_numbers():
    for numbers in (False, True):
        _, packed = completed_and_packed("action_msgs/GoalStatusArray", {"status_list": [{}]}, numbers=numbers)
        assert packed["status_list"][0]["goal_info"]["goal_id"]["uuid"] == bytes(16)
    _, packed = completed_and_packed("std_msgs/Float64MultiArray", {"data": [1.5]}, numbers=False)
    assert packed["data"] == [1.5]


def test_a_message_is_left_as_it_was_and_copied_only_for_arrays():
    message, packed = completed_and_packed("moveit_msgs/AllowedCollisionMatrix", {"entry_names": ["a"]}, numbers=True)
    assert packed == message
    message, _ = completed_and_packed("std_msgs/UInt8MultiArray", {"data": [1]}, numbers=True)
    assert message["data"] == "AQ=="
    message, packed = completed_and_packed("geometry_msgs/PoseArray", {"poses": [{}]}, numbers=True)
    assert packed is message


@given(st.text())
def test_a_frame_is_one_map_of_op_topic_and_message_in_this_order(topic):
    message = {"data": [1, 2.5, "ü", True, None, b"\x00"]}
    frame = cbor2.loads(cbor.publish(topic, cbor.encode(message)))
    assert list(frame.items()) == [("op", "publish"), ("topic", topic), ("msg", message)]


def test_floats_stay_floats():
    not_a_number, infinity = cbor2.loads(cbor.encode({"data": [math.nan, math.inf]}))["data"]
    assert (math.isnan(not_a_number), infinity) == (True, math.inf)
    assert type(cbor2.loads(cbor.encode({"data": 2.0}))["data"]) is float
