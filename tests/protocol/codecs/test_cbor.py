import math
import struct

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import cbor
from protocol.messages import Stamp, complete
from tests.helpers.messages import REGISTRY

NOW = Stamp(1, 2)

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


@pytest.mark.parametrize(("name", "tag", "code"), [(name, *row) for name, row in TAGS.items()])
def test_numbers_become_a_typed_array_of_their_tag_little_endian(name, tag, code):
    type_name = f"std_msgs/{name}MultiArray"
    message = complete(REGISTRY, type_name, {"data": [1, 2, 100]}, NOW)
    packed = cbor.packed(REGISTRY, type_name, message, numbers=True)["data"]
    assert packed == cbor2.CBORTag(tag, struct.pack(f"<3{code}", 1, 2, 100))


@pytest.mark.parametrize("numbers", [False, True])
def test_base64_text_becomes_octets_at_any_depth(numbers):
    message = complete(REGISTRY, "action_msgs/GoalStatusArray", {"status_list": [{}]}, NOW)
    status = cbor.packed(REGISTRY, "action_msgs/GoalStatusArray", message, numbers=numbers)["status_list"][0]
    assert status["goal_info"]["goal_id"]["uuid"] == bytes(16)


def test_text_truth_values_and_single_numbers_stay_as_they_are():
    message = complete(REGISTRY, "moveit_msgs/AllowedCollisionMatrix", {"entry_names": ["a"]}, NOW)
    assert cbor.packed(REGISTRY, "moveit_msgs/AllowedCollisionMatrix", message, numbers=True) == message


def test_octets_alone_leave_lists_of_numbers():
    message = complete(REGISTRY, "std_msgs/Float64MultiArray", {"data": [1.5]}, NOW)
    assert cbor.packed(REGISTRY, "std_msgs/Float64MultiArray", message, numbers=False)["data"] == [1.5]


def test_a_message_is_left_as_it_was_and_copied_only_for_arrays():
    message = complete(REGISTRY, "std_msgs/UInt8MultiArray", {"data": [1]}, NOW)
    cbor.packed(REGISTRY, "std_msgs/UInt8MultiArray", message, numbers=True)
    assert message["data"] == "AQ=="
    message = complete(REGISTRY, "geometry_msgs/PoseArray", {"poses": [{}]}, NOW)
    assert cbor.packed(REGISTRY, "geometry_msgs/PoseArray", message, numbers=True) is message


@given(st.text())
def test_a_frame_is_one_map_of_op_topic_and_message_in_this_order(topic):
    message = {"data": [1, 2.5, "ü", True, None, b"\x00"]}
    frame = cbor2.loads(cbor.publish(topic, cbor.encode(message)))
    assert list(frame.items()) == [("op", "publish"), ("topic", topic), ("msg", message)]


def test_floats_stay_floats():
    not_a_number, infinity = cbor2.loads(cbor.encode({"data": [math.nan, math.inf]}))["data"]
    assert math.isnan(not_a_number)
    assert infinity == math.inf
    assert type(cbor2.loads(cbor.encode({"data": 2.0}))["data"]) is float


@given(
    st.recursive(st.integers() | st.text(max_size=3), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))
)
def test_a_message_encoded_in_pieces_is_the_message(value):
    message = {"value": value, "many": [value] * 501}
    assert cbor2.loads(cbor.encode(message)) == message
