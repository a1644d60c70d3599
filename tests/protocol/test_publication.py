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
from protocol.limits import MAX_PIECES
from protocol.messages import Stamp, complete
from protocol.publication import LARGE_BYTES, EncodedMessage, Frame, PublishedMessage, pack
from tests.helpers.messages import REGISTRY


@given(st.text(alphabet='ab"{}', min_size=1, max_size=200), st.integers(min_value=1, max_value=250))
def test_fragments_put_together_are_the_frame_which_stays_whole_if_it_is_short_or_binary(text, size):
    frame = Frame(text.encode(), text=True)
    for enough in (None, len(text), len(text) + size):
        assert pack(frame, enough, "f").frames == (frame,)
    assert pack(Frame(frame.data, text=False), size, "f").frames == ((frame.data, False),)
    frames = pack(frame, size, "f").frames
    if len(text) > size:
        pieces = [json.loads(frame.data) for frame in frames]
        assert "".join(piece["data"] for piece in pieces) == text
        assert all(len(piece["data"]) <= size for piece in pieces)
        assert [piece["num"] for piece in pieces] == list(range(len(pieces)))
        assert {(piece["id"], piece["total"]) for piece in pieces} == {("f", len(pieces))}


def test_a_message_never_becomes_more_pieces_than_the_limit():
    assert len(pack(Frame(b"x" * (3 * MAX_PIECES), text=True), 1, "f").frames) == MAX_PIECES


def parsed(stream):
    """The WebSocket frames in a stream of octets, as a client reads them."""
    reader = StreamReader()
    reader.feed_data(stream)
    while reader.buffer:
        parsing = WebSocketFrame.parse(reader.read_exact, mask=False)
        with pytest.raises(StopIteration) as found:
            next(parsing)
        yield found.value.value


@pytest.mark.parametrize("length", [0, 1, 125, 126, 127, 65_535, 65_536, 300_000, 1 << 20])
def test_on_the_wire_a_frame_is_a_whole_message_of_its_kind_also_in_pieces(length):
    for text in (True, False):
        frame = Frame(b"x" * length, text=text)
        (read,) = parsed(b"".join(EncodedMessage(frame).wire))
        assert (read.opcode, read.data, read.fin) == (Opcode.TEXT if text else Opcode.BINARY, frame.data, True)
    parts = (b"a", b"x" * length, b"b")
    message, frame = EncodedMessage.text(*parts), Frame(b"".join(parts), text=True)
    assert b"".join(message.wire) == b"".join(EncodedMessage(frame).wire)
    # A large message is not copied.
    assert length < LARGE_BYTES or message.wire[-2] is parts[1]
    assert message.frames == (frame,)


RECEIVED = Stamp(5, 6)
ENCODINGS = ["none", "png", "cbor", "cbor-raw", "bson"]


def published(data="hello"):
    msg = complete(REGISTRY, "std_msgs/msg/String", {"data": data}, RECEIVED)
    return PublishedMessage("/chatter", "std_msgs/msg/String", msg, REGISTRY, RECEIVED)


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


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_message_is_encoded_once_for_all_that_want_the_same_and_goes_out_as_it_came_if_its_type_is_unknown(encoding):
    for dialect in ("ros2", "ros1"):
        message = published()
        first, second = (message.encoded("/chatter", encoding, dialect, None) for _ in range(2))
        assert first.wire[-1] is second.wire[-1]
        message = PublishedMessage("/a", "my_msgs/msg/Own", {"list": [1, 2]}, REGISTRY, RECEIVED)
        assert decoded(frame_of(message, "/a", encoding, dialect), encoding)["msg"] == {"list": [1, 2]}
    if encoding != "png":
        message = published("before")
        first = decoded(frame_of(message, "/chatter", encoding), encoding)
        message.msg["data"] = "after"
        assert decoded(frame_of(message, "chatter", encoding), encoding)["msg"] == first["msg"]


def test_a_publications_size_is_that_of_its_message_as_it_went_out_and_else_as_json():
    assert published().size_bytes == len(b'{"data":"hello"}')
    sent = published("x" * 1000)
    frame_of(sent, "chatter", "cbor")
    assert 1000 < sent.size_bytes < len(frame_of(sent, "chatter", "cbor").data)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_large_message_is_encoded_later_and_then_as_a_small_one(encoding):
    text = "x" * LARGE_BYTES
    large = published(text).encoded("/chatter", encoding, "ros2", None)
    assert not large.ready
    large.encode()
    assert large.ready
    assert encoding == "cbor-raw" or decoded(large.frames[0], encoding)["msg"] == {"data": text}
    fragments = published(text).encoded("/chatter", "none", "ros2", 10_000)
    fragments.encode()
    assert len(fragments.frames) == 7
