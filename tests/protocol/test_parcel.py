import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.frames import Frame as WebSocketFrame
from websockets.frames import Opcode
from websockets.streams import StreamReader

from protocol.limits import MAX_PIECES
from protocol.parcel import FRAME_OVERHEAD_BYTES, Frame, Parcel, pack


def text_frame(length):
    return Frame(b"x" * length, text=True)


def test_a_parcel_costs_its_frames_and_what_is_spent_on_each():
    assert Parcel(text_frame(10), text_frame(20)).size_bytes == 30 + 2 * FRAME_OVERHEAD_BYTES


@pytest.mark.parametrize(
    ("frame", "size"),
    [(text_frame(100), None), (text_frame(100), 100), (Frame(b"x" * 100, text=False), 10)],
)
def test_what_is_short_enough_or_binary_stays_whole(frame, size):
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
    (read,) = parsed(Parcel(frame).on_wire)
    assert (read.opcode, read.data, read.fin) == (Opcode.TEXT if text else Opcode.BINARY, frame.data, True)


def test_on_the_wire_frames_follow_each_other():
    assert [frame.data for frame in parsed(Parcel(*map(text_frame, (3, 200, 5))).on_wire)] == [
        b"x" * length for length in (3, 200, 5)
    ]


def test_what_goes_over_the_wire_is_made_once():
    parcel = Parcel(text_frame(10))
    assert parcel.on_wire is parcel.on_wire
