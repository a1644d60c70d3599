import json
import threading

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import join
from protocol.codecs import json as codec
from protocol.codecs.long_json import MAX_CONTAINERS, decode_in_pieces
from protocol.errors import FrameError

texts = st.text(max_size=8)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(texts, inner, max_size=6),
    max_leaves=60,
)
breaks = st.sampled_from([b"", b",", b"]", b"}", b"[", b"{", b'"', b"\\"])


def plain(piece: bytes, _offset: int) -> object:
    return orjson.loads(piece)


@given(values, st.integers(1, 40), st.sampled_from([None, 1]), breaks, st.data())
def test_what_is_decoded_or_refused_in_pieces_is_so_at_once(
    value: object, piece_bytes: int, indent: int, broken: bytes, data: st.DataObject
) -> None:
    text = json.dumps(value, ensure_ascii=False, indent=indent).encode()
    assert decode_in_pieces(text, plain, 64, piece_bytes) == orjson.loads(text)
    place = data.draw(st.integers(0, len(text) - 1))
    text = text[:place] + broken + text[place + 1 :]
    try:
        wanted = orjson.loads(text)
    except orjson.JSONDecodeError:
        with pytest.raises((orjson.JSONDecodeError, FrameError)):
            decode_in_pieces(text, plain, 64, piece_bytes)
    else:
        assert decode_in_pieces(text, plain, 64, piece_bytes) == wanted


POINTS = [{"x": number, "y": [0.5, None], "z": '"},{["\\'} for number in range(20_000)]
LONG = {"op": "publish", "msg": {"points": POINTS}}


def test_no_piece_is_much_longer_than_it_has_to_be() -> None:
    lengths = []

    def note(piece: bytes, _offset: int) -> object:
        lengths.append(len(piece))
        return orjson.loads(piece)

    text = json.dumps(LONG).encode()
    assert decode_in_pieces(text, note, 64, 1000) == LONG
    assert max(lengths) < 1200
    assert sum(lengths) > len(text) - 2 * len(lengths)


def test_long_frames_are_read_and_refused_as_short_ones() -> None:
    numbers = codec.decode(b"[" + b"1.5," * 100_000 + b"Infinity]")
    assert numbers == [1.5] * 100_000 + [float("inf")]
    broken, many = b"[" + b"1," * 200_000 + b"x]", b"[" + b"[]," * MAX_CONTAINERS + b"[]]"
    for text, problem in (
        (broken, f"at position {broken.index(b'x')}"),
        (many, f"{MAX_CONTAINERS + 2} lists and objects, the limit is"),
        (b"[" * 300_000 + b"]" * 300_000, "nested deeper than the limit of 64 levels"),
        (b'["' + b"x" * 300_000, "not JSON"),
        ('["\ud800' + "x" * 300_000 + '"]', "lone surrogate"),
    ):
        with pytest.raises(FrameError, match=problem):
            codec.decode(text)


def test_an_object_that_names_a_key_twice_around_a_cut_does_no_harm() -> None:
    text = b'{"a":[' + b"1," * 10 + b'1],"b":1,"a":[' + b"2," * 10 + b"2]}"
    for piece_bytes in range(1, 60):
        try:
            decode_in_pieces(text, plain, 64, piece_bytes)
        except FrameError as error:
            assert "the same key twice" in str(error)  # noqa: PT017 - either way is fine, nothing else may happen


def test_other_threads_have_their_turn_between_the_pieces() -> None:
    text = json.dumps([float(number) for number in range(500_000)]).encode()
    turns, done = 0, threading.Event()

    def decode() -> None:
        codec.decode(text)
        done.set()

    thread = threading.Thread(target=decode)
    thread.start()
    while not done.wait(0.0):
        turns += 1
    join(thread)
    assert turns > 3
