import base64
import contextlib
import datetime as dt
import struct

import bson as pymongo_bson
import pytest
from bson.binary import Binary
from bson.code import Code
from bson.int64 import Int64
from bson.regex import Regex
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import bson
from protocol.codecs.json import MAX_NESTING_DEPTH
from protocol.errors import FrameError

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
def test_whatever_follows_the_length_is_read_or_refused(body):
    frame = struct.pack("<i", len(body) + 5) + body + b"\x00"
    assert bson.is_document(frame)
    with contextlib.suppress(FrameError):
        bson.decode(frame)


def test_other_frames_are_no_documents():
    frames = b"", b"{}", b'{"op":"publish"}', b"\x05\x00\x00\x00", b"\x05\x00\x00\x00\x01", b"\x06\x00\x00\x00\x00"
    assert not any(map(bson.is_document, frames))
