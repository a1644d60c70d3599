import json

import bson
import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.frames import Frame as WebSocketFrame
from websockets.frames import Opcode
from websockets.streams import StreamReader

from protocol.codecs import png
from protocol.codecs.pieces import encoding_cost_bytes
from protocol.limits import MAX_PIECES
from protocol.messages import Stamp, complete
from protocol.publication import LARGE_BYTES, EncodedMessage, Frame, PublishedMessage, pack
from tests.helpers.messages import REGISTRY


def text_frame(length):
    return Frame(b"x" * length, text=True)


@pytest.mark.parametrize(
    ("frame", "size"), [(text_frame(100), None), (text_frame(100), 100), (Frame(b"x" * 100, text=False), 10)]
)
def test_a_short_or_binary_frame_stays_whole(frame, size):
    assert pack(frame, size, "f").frames == (frame,)


@given(st.text(alphabet='ab"{}', min_size=1, max_size=200), st.integers(min_value=1, max_value=250))
def test_fragments_put_together_are_the_frame(text, size):
    frames = pack(Frame(text.encode(), text=True), size, "f").frames
    if len(text) <= size:
        assert frames == ((text.encode(), True),)
        return
    pieces = [json.loads(frame.data) for frame in frames]
    assert "".join(piece["data"] for piece in pieces) == text
    assert all(len(piece["data"]) <= size for piece in pieces)
    assert [piece["num"] for piece in pieces] == list(range(len(pieces)))
    assert {(piece["id"], piece["total"]) for piece in pieces} == {("f", len(pieces))}


def test_a_message_never_becomes_more_pieces_than_the_limit():
    assert len(pack(text_frame(3 * MAX_PIECES), 1, "f").frames) == MAX_PIECES


def parsed(stream):
    """The WebSocket frames in a stream of octets, as a client reads them."""
    reader = StreamReader()
    reader.feed_data(stream)
    while reader.buffer:
        parsing = WebSocketFrame.parse(reader.read_exact, mask=False)
        with pytest.raises(StopIteration) as found:
            next(parsing)
        yield found.value.value


@pytest.mark.parametrize("length", [0, 1, 125, 126, 127, 65_535, 65_536, 1 << 20])
@pytest.mark.parametrize("text", [True, False])
def test_on_the_wire_a_frame_is_a_whole_message_of_its_kind(length, text):
    frame = Frame(b"x" * length, text=text)
    (read,) = parsed(EncodedMessage(frame).on_wire)
    assert (read.opcode, read.data, read.fin) == (Opcode.TEXT if text else Opcode.BINARY, frame.data, True)


RECEIVED = Stamp(5, 6)
ENCODINGS = ["none", "png", "cbor", "cbor-raw", "bson"]


def published(type_name="std_msgs/msg/String", msg=None):
    msg = complete(REGISTRY, type_name, {"data": "hello"} if msg is None else msg, RECEIVED)
    return PublishedMessage("/chatter", type_name, msg, REGISTRY, RECEIVED)


def frame_of(message, spelled_topic, encoding="none", dialect="ros2"):
    """The frame for subscribers that spell the topic like this and want this encoding and dialect."""
    encoded = message.encoded(spelled_topic, encoding, dialect, None)
    encoded.encode()
    return encoded.frames[0]


def decoded(frame, encoding):
    if encoding == "bson":
        return bson.decode(frame.data)
    if encoding == "png":
        return json.loads(png.decode(json.loads(frame.data)["data"]))
    return json.loads(frame.data) if encoding == "none" else cbor2.loads(frame.data)


@pytest.mark.parametrize("dialect", ["ros2", "ros1"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_subscribers_that_want_the_same_share_the_same_bytes(encoding, dialect):
    message = published()
    first, second = (message.encoded("/chatter", encoding, dialect, None) for _ in range(2))
    assert first.on_wire is second.on_wire


@pytest.mark.parametrize("encoding", ["none", "cbor", "cbor-raw", "bson"])
def test_the_message_is_encoded_once_for_all_spellings(encoding):
    message = published(msg={"data": "before"})
    first = frame_of(message, "/chatter", encoding)
    message.msg["data"] = "after"
    second = frame_of(message, "chatter", encoding)
    assert decoded(second, encoding)["msg"] == decoded(first, encoding)["msg"]


@pytest.mark.parametrize("dialect", ["ros2", "ros1"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_message_of_an_unknown_type_goes_out_as_it_came(encoding, dialect):
    message = PublishedMessage("/a", "my_msgs/msg/Own", {"list": [1, 2]}, REGISTRY, RECEIVED)
    assert decoded(frame_of(message, "/a", encoding, dialect), encoding)["msg"] == {"list": [1, 2]}


def test_a_publications_size_is_that_of_its_message_as_it_went_out_and_else_as_json():
    assert published().size_bytes == len(b'{"data":"hello"}')
    sent = published(msg={"data": "x" * 1000})
    frame_of(sent, "chatter", "cbor")
    assert 1000 < sent.size_bytes < len(frame_of(sent, "chatter", "cbor").data)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_large_message_is_encoded_later_and_then_as_a_small_one(encoding):
    text = "x" * LARGE_BYTES
    large = published(msg={"data": text}).encoded("/chatter", encoding, "ros2", None)
    assert not large.ready
    large.encode()
    assert large.ready
    if encoding != "cbor-raw":
        assert decoded(large.frames[0], encoding)["msg"] == {"data": text}


def test_the_fragments_of_a_large_message_are_made_later_too():
    large = published(msg={"data": "x" * LARGE_BYTES}).encoded("/chatter", "none", "ros2", 10_000)
    large.encode()
    assert len(large.frames) == 7


@given(
    st.recursive(st.integers() | st.text(max_size=5), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))
)
def test_the_cost_of_encoding_is_estimated_without_looking_at_everything(value):
    assert 0 <= encoding_cost_bytes(value, LARGE_BYTES) <= LARGE_BYTES


@pytest.mark.parametrize(
    "value", [[0.5] * 10_000, {"data": "x" * LARGE_BYTES}, [{"x": 1.0, "y": 1.0}] * 3000, [["x" * 100] * 10] * 100]
)
def test_what_is_large_is_found_to_be(value):
    assert encoding_cost_bytes(value, LARGE_BYTES) == LARGE_BYTES


@pytest.mark.parametrize("length", [0, 1, 125, 126, 65_000, 70_000, 300_000])
def test_the_pieces_on_the_wire_are_the_frame_in_order(length):
    parts = (b"a", b"x" * length, b"b")
    message = EncodedMessage.text(*parts)
    assert b"".join(message.wire_pieces()) == Frame(b"".join(parts), text=True).on_wire() == message.on_wire
    assert message.frames == (Frame(b"".join(parts), text=True),)
