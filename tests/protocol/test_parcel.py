import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
