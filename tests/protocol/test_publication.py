import base64
import json

import bson
import cbor2
import pytest

from protocol.codecs import png
from protocol.messages import Stamp, complete
from protocol.publication import Publication
from protocol.registry import Registry
from tests.helpers.cdr import deserialize

REGISTRY = Registry.load()
RECEIVED = Stamp(5, 6)
ENCODINGS = ["none", "png", "cbor", "cbor-raw", "bson"]


def publication(type_name="std_msgs/msg/String", msg=None):
    msg = complete(REGISTRY, type_name, {"data": "hello"} if msg is None else msg, RECEIVED)
    return Publication("/chatter", type_name, msg, REGISTRY, RECEIVED)


def decoded(frame, encoding):
    if encoding == "bson":
        return bson.decode(frame.data)
    if encoding == "png":
        return json.loads(png.decode(json.loads(frame.data)["data"]))
    return json.loads(frame.data) if encoding == "none" else cbor2.loads(frame.data)


def test_a_json_frame_has_three_keys_in_order_and_the_topic_as_the_subscriber_spells_it():
    frame = publication().frame("chatter")
    assert frame == (b'{"op":"publish","topic":"chatter","msg":{"data":"hello"}}', True)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_carries_op_and_topic_as_spelled_and_is_text_or_binary(encoding):
    frame = publication().frame("chatter", encoding)
    assert list(decoded(frame, encoding)) == ["op", "topic", "msg"]
    assert decoded(frame, encoding)["topic"] == "chatter"
    assert frame.text == (encoding in ("none", "png"))


@pytest.mark.parametrize("encoding", ["none", "png", "cbor", "bson"])
def test_a_message_of_text_is_the_same_in_every_encoding(encoding):
    frame = publication(msg={"data": "größer 😀"}).frame("/chatter", encoding)
    assert decoded(frame, encoding)["msg"] == {"data": "größer 😀"}


@pytest.mark.parametrize("dialect", ["ros2", "ros1"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_subscribers_that_want_the_same_share_the_same_bytes(encoding, dialect):
    message = publication()
    assert message.frame("/chatter", encoding, dialect).data is message.frame("/chatter", encoding, dialect).data


@pytest.mark.parametrize("encoding", ["none", "cbor", "cbor-raw", "bson"])
def test_the_message_is_encoded_once_for_all_spellings(encoding):
    message = publication(msg={"data": "before"})
    first = message.frame("/chatter", encoding)
    message.msg["data"] = "after"
    second = message.frame("chatter", encoding)
    assert decoded(second, encoding)["msg"] == decoded(first, encoding)["msg"]


def test_json_topics_and_messages_beyond_ascii_are_escaped():
    frame = publication(msg={"data": "größer 😀"}).frame('/a"ü')
    assert frame.data.isascii()
    assert json.loads(frame.data) == {"op": "publish", "topic": '/a"ü', "msg": {"data": "größer 😀"}}


def test_nan_and_infinity_are_null_in_json():
    msg = {"data": [float("nan"), float("inf"), 1.0]}
    frame = publication("std_msgs/msg/Float64MultiArray", msg).frame("/a")
    assert json.loads(frame.data)["msg"]["data"] == [None, None, 1.0]


def test_a_joint_state_goes_out_in_cbor_with_its_names():
    msg = {"name": ["a", "b"], "position": [1.0, 2.5]}
    frame = publication("sensor_msgs/msg/JointState", msg).frame("/a", "cbor")
    sent = cbor2.loads(frame.data)["msg"]
    assert sent["name"] == ["a", "b"]
    assert sent["position"].tag == 86


@pytest.mark.parametrize("encoding", ["cbor", "bson"])
def test_octets_are_binary_data_in_binary_encodings(encoding):
    msg = {"data": base64.b64encode(b"\x00\xff").decode()}
    frame = publication("std_msgs/msg/UInt8MultiArray", msg).frame("/a", encoding)
    assert decoded(frame, encoding)["msg"]["data"] == b"\x00\xff"


@pytest.mark.parametrize("dialect", ["ros2", "ros1"])
def test_cbor_raw_carries_the_time_of_receipt_and_the_serialized_message(dialect):
    sent = cbor2.loads(publication().frame("/chatter", "cbor-raw", dialect).data)["msg"]
    assert (sent["secs"], sent["nsecs"]) == RECEIVED
    assert deserialize(REGISTRY, "std_msgs/String", sent["bytes"]) == {"data": "hello"}


@pytest.mark.parametrize("encoding", ["none", "png", "cbor", "bson"])
def test_ros1_subscribers_get_ros1_spelling_in_every_encoding(encoding):
    message = publication("std_msgs/msg/Header", {"frame_id": "a"})
    sent = decoded(message.frame("/a", encoding, "ros1"), encoding)["msg"]
    assert sent == {"seq": 0, "stamp": {"secs": 5, "nsecs": 6}, "frame_id": "a"}
    assert "seq" not in decoded(message.frame("/a", encoding), encoding)["msg"]


@pytest.mark.parametrize("dialect", ["ros2", "ros1"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_message_of_an_unknown_type_goes_out_as_it_came(encoding, dialect):
    message = Publication("/a", "my_msgs/msg/Own", {"list": [1, 2]}, REGISTRY, RECEIVED)
    assert decoded(message.frame("/a", encoding, dialect), encoding)["msg"] == {"list": [1, 2]}


def test_a_publications_size_is_that_of_its_message_as_it_went_out_and_else_as_json():
    assert publication().size_bytes == len(b'{"data":"hello"}')
    sent = publication(msg={"data": "x" * 1000})
    sent.frame("chatter", "cbor")
    assert 1000 < sent.size_bytes < len(sent.frame("chatter", "cbor").data)
