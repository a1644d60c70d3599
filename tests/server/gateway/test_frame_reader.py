"""Messages and other frames, told apart however what the socket receives is cut."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.frames import Frame, Opcode

from server.gateway.frame_reader import FrameReader

LIMIT_BYTES = 70_000

LENGTHS = st.one_of(st.integers(0, 300), st.sampled_from((125, 126, 127, 65_535, 65_536, LIMIT_BYTES)))
MESSAGES = st.tuples(st.sampled_from((Opcode.TEXT, Opcode.BINARY)), LENGTHS)


def serialized(opcode: Opcode, length: int, *, fin: bool = True, mask: bool = True) -> bytes:
    return Frame(opcode, b"x" * length, fin=fin).serialize(mask=mask)


def read(received: bytes, cuts: list[int], limit_bytes: int | None = LIMIT_BYTES) -> Iterator[tuple[bool, bytes]]:
    """Go over what is read, and whether it is a message."""
    reader, places = FrameReader(), [0, *sorted(cut % (len(received) + 1) for cut in cuts), len(received)]
    for begin, end in itertools.pairwise(places):
        data, place = received[begin:end], 0
        while place < len(data):
            place, piece = reader.next(data, place, limit_bytes)
            if piece is not None:
                yield bool(piece.header_bytes), bytes(piece.raw)


@given(st.lists(MESSAGES, max_size=5), st.lists(st.integers(0, 1_000_000), max_size=20))
def test_whole_messages_are_read_however_they_are_cut(messages: list[tuple[Opcode, int]], cuts: list[int]) -> None:
    frames = [serialized(*each) for each in messages]
    assert list(read(b"".join(frames), cuts)) == [(True, frame) for frame in frames]


@given(
    st.lists(
        st.one_of(
            st.builds(serialized, st.sampled_from(list(Opcode)), st.integers(0, 125)),
            st.builds(serialized, st.sampled_from((Opcode.CONT, Opcode.TEXT)), st.integers(0, 200), fin=st.booleans()),
            st.builds(serialized, st.just(Opcode.TEXT), st.just(300), mask=st.booleans()),
            st.binary(max_size=20),
        ),
        max_size=6,
    ),
    st.lists(st.integers(0, 3000), max_size=20),
)
def test_nothing_is_lost_and_nothing_is_changed_of_whatever_comes(frames: list[bytes], cuts: list[int]) -> None:
    received = b"".join(frames)
    taken = b"".join(raw for _, raw in read(received, cuts))
    # The last frame may not have come to its end.
    assert received.startswith(taken)


@pytest.mark.parametrize("cut", range(15))
@pytest.mark.parametrize(
    "frame",
    [
        serialized(Opcode.PING, 5),
        serialized(Opcode.CLOSE, 2),
        serialized(Opcode.TEXT, 5, mask=False),
        serialized(Opcode.TEXT, LIMIT_BYTES + 1),
        bytes((0xC1,)) + serialized(Opcode.TEXT, 5)[1:],
    ],
    ids=["ping", "close", "not masked", "too long", "compressed"],
)
def test_everything_else_is_left_to_websockets(frame: bytes, cut: int) -> None:
    message = serialized(Opcode.TEXT, 3)
    pieces = list(read(frame + message, [cut]))
    assert b"".join(raw for is_message, raw in pieces if not is_message) == frame
    assert pieces[-1] == (True, message)


def test_messages_between_fragments_are_left_to_websockets_which_knows_that_they_may_not_be_there() -> None:
    begin, middle = serialized(Opcode.TEXT, 5, fin=False), serialized(Opcode.CONT, 5, fin=False)
    message, end = serialized(Opcode.TEXT, 7), serialized(Opcode.CONT, 5)
    pieces = list(read(begin + message + middle + end + message, []))
    assert [is_message for is_message, _ in pieces] == [False, False, False, False, True]


def test_a_ping_between_fragments_does_not_end_them() -> None:
    begin, ping, message = serialized(Opcode.TEXT, 5, fin=False), serialized(Opcode.PING, 1), serialized(Opcode.TEXT, 7)
    assert [is_message for is_message, _ in read(begin + ping + message, [])] == [False, False, False]


@pytest.mark.parametrize("mask", [b"\0\0\0\0", b"\x01\x02\x03\x04"])
def test_the_mask_is_taken_off(mask: bytes) -> None:
    masked = bytes(octet ^ mask[place % 4] for place, octet in enumerate("äbc".encode()))
    _, piece = FrameReader().next(bytes((0x81, 0x84)) + mask + masked, 0, None)
    assert piece is not None
    assert piece.message() == "äbc"


def test_text_that_is_not_utf_8_is_not_read() -> None:
    _, piece = FrameReader().next(Frame(Opcode.TEXT, b"\xff").serialize(mask=True), 0, None)
    assert piece is not None
    with pytest.raises(UnicodeDecodeError):
        piece.message()
