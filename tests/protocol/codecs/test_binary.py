"""BSON, CBOR and pictures."""

import base64
import contextlib
import datetime as dt
import io
import math
import struct

import bson as pymongo_bson
import cbor2
import pytest
from bson.binary import Binary
from bson.code import Code
from bson.int64 import Int64
from bson.regex import Regex
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from protocol.codecs import bson, cbor, png
from protocol.codecs.json import MAX_NESTING_DEPTH
from protocol.errors import FrameError
from protocol.messages import Stamp, complete
from tests.helpers.messages import REGISTRY

json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(st.characters(min_codepoint=97, max_codepoint=122)), inner),
    max_leaves=20,
)


@given(json_values, st.text(st.characters(exclude_categories=["Cs"])))
def test_an_encoded_value_is_one_document_and_a_published_frame_one_of_op_topic_and_message(value, topic):
    frame = bson.encode({"value": value})
    assert bson.is_document(frame)
    assert bson.decode(frame) == {"value": value}
    published = bson.decode(bson.publish(topic, frame))
    assert list(published.items()) == [("op", "publish"), ("topic", topic), ("msg", {"value": value})]


def test_octets_and_integers_have_the_types_that_clients_read():
    for octets in (b"\x00\xff", Binary(b"\x00\xff", 128)):
        assert bson.decode(pymongo_bson.encode({"data": octets})) == {"data": base64.b64encode(b"\x00\xff").decode()}
    assert b"\x05data\x00\x02\x00\x00\x00\x00\x00\xff" in bson.encode({"data": b"\x00\xff"})
    value = bson.decode(pymongo_bson.encode({"data": Int64(5)}))["data"]
    assert type(value) is int
    assert b"\x10secs\x00" + struct.pack("<i", 1_700_000_000) in bson.encode({"secs": 1_700_000_000})
    assert bson.decode(bson.encode({"a": [{"b": 2**64 - 1}], "c": 1})) == {"a": [{"b": 2.0**64}], "c": 1}
    # A key loses the zeros that would end it.
    assert bson.decode(bson.encode({"a\x00b": [{"\x00": 2**64 - 1}]})) == {"ab": [{"": float(2**64 - 1)}]}


def test_types_that_json_has_not_are_refused_by_name():
    date, reference = dt.datetime(2020, 1, 1, tzinfo=dt.UTC), {"$ref": "a", "$id": 1}
    for value in (date, Regex("a"), Code("a"), pymongo_bson.ObjectId(), reference):
        with pytest.raises(FrameError, match="type"):
            bson.decode(pymongo_bson.encode({"data": value}))


def nested(depth):
    document = pymongo_bson.encode({})
    for _ in range(depth - 1):
        document = struct.pack("<i", len(document) + 8) + b"\x03a\x00" + document + b"\x00"
    return document


def test_nesting_has_a_limit():
    bson.decode(nested(MAX_NESTING_DEPTH))
    with pytest.raises(FrameError, match=f"limit of {MAX_NESTING_DEPTH}"):
        bson.decode(nested(MAX_NESTING_DEPTH + 1))
    with pytest.raises(FrameError):
        bson.decode(nested(20_000))


@given(st.binary(max_size=50))
def test_whatever_follows_the_length_is_read_or_refused_and_other_frames_are_no_documents(body):
    frame = struct.pack("<i", len(body) + 5) + body + b"\x00"
    assert bson.is_document(frame)
    with contextlib.suppress(FrameError):
        bson.decode(frame)
    frames = b"", b"{}", b'{"op":"publish"}', b"\x05\x00\x00\x00", b"\x05\x00\x00\x00\x01", b"\x06\x00\x00\x00\x00"
    assert not any(map(bson.is_document, frames))


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


def test_numbers_become_a_typed_array_of_their_tag_and_base64_text_octets_at_any_depth():
    for name, (tag, code) in TAGS.items():
        _, packed = completed_and_packed(f"std_msgs/{name}MultiArray", {"data": [1, 2, 100]}, numbers=True)
        assert packed["data"] == cbor2.CBORTag(tag, struct.pack(f"<3{code}", 1, 2, 100))
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
def test_a_frame_is_one_map_of_op_topic_and_message_in_this_order_and_floats_stay_floats(topic):
    message = {"data": [1, 2.5, "ü", True, None, b"\x00"]}
    frame = cbor2.loads(cbor.publish(topic, cbor.encode(message)))
    assert list(frame.items()) == [("op", "publish"), ("topic", topic), ("msg", message)]
    not_a_number, infinity, two = cbor2.loads(cbor.encode({"data": [math.nan, math.inf, 2.0]}))["data"]
    assert (math.isnan(not_a_number), infinity, type(two)) == (True, math.inf, float)


def drawn(mode, size):
    buffer = io.BytesIO()
    Image.new(mode, size).save(buffer, format="PNG")
    return base64.b64encode(buffer.getvalue()).decode()


@given(st.binary(max_size=2000).filter(lambda frame: not frame.endswith(b"\n")), st.integers(3, 3000))
def test_text_in_a_picture_as_square_as_can_be_is_read_back_but_for_newlines_behind_it(frame, size):
    assert png.decode(png.encode(frame)).rstrip(b"\n") == frame
    frame = b"x" * size
    picture = Image.open(io.BytesIO(base64.b64decode(png.encode(frame))))
    assert picture.mode == "RGB"
    assert abs(picture.width - math.sqrt(size / 3)) <= 1
    assert picture.height >= picture.width
    assert picture.tobytes() == frame.ljust(picture.width * picture.height * 3, b"\n")
    # It is smaller than the text.
    frame = b'{"position":[0.123456789,0.987654321,-0.55555555]}' * 1000
    assert len(png.encode(frame)) < len(frame) / 10


def test_data_that_is_no_picture_or_one_of_another_mode_or_of_a_huge_frame_is_refused():
    for data, words in (
        ("", "not"),
        ("no base64!", "not"),
        ("aGVsbG8=", "not"),
        (drawn("RGB", (4, 4))[:60], "not"),
        *((drawn(mode, (2, 2)), f"mode {mode}") for mode in ("L", "RGBA", "P")),
        # Before it is unpacked.
        (drawn("RGB", (3000, 3000)), r"limit is 10000000"),
        (drawn("1", (14_000, 14_000)), "Decompression"),
    ):
        with pytest.raises(FrameError, match=words):
            png.decode(data)
