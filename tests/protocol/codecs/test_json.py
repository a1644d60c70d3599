"""JSON: whole frames, long ones in pieces, and pieces that are encoded."""

import itertools
import json as stdlib_json
import math
import threading
from typing import Any

import cbor2
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import join
from protocol.codecs import cbor, json
from protocol.codecs.long_json import MAX_CONTAINERS, decode_in_pieces
from protocol.codecs.pieces import encoded_pieces, encoding_cost_bytes, json_notation
from protocol.errors import FrameError
from protocol.publication import LARGE_BYTES
from tests.helpers.programs import run_python
from tests.helpers.resources import examples

json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


def without_infinities(value):
    if isinstance(value, list):
        return [without_infinities(child) for child in value]
    if isinstance(value, dict):
        return {key: without_infinities(child) for key, child in value.items()}
    return None if isinstance(value, float) and math.isinf(value) else value


@given(json_values)
def test_an_encoded_value_is_ascii_and_decodes_to_the_same_as_what_other_encoders_make(value):
    encoded = json.encode(value)
    assert encoded.isascii()
    assert json.decode(encoded) == stdlib_json.loads(encoded) == without_infinities(value)
    text = stdlib_json.dumps(value, ensure_ascii=False)
    assert json.decode(text) == json.decode(text.encode()) == value
    assert json.encode({"ü": '€"😀'}) == b'{"\\u00fc":"\\u20ac\\"\\ud83d\\ude00"}'
    # NaN and infinities go out as null, and their tokens come in as floats.
    assert json.encode([math.nan, math.inf, -math.inf]) == b"[null,null,null]"
    not_a_number, *infinities = json.decode(b"[NaN,Infinity,-Infinity]")
    assert math.isnan(not_a_number)
    assert infinities == [math.inf, -math.inf]


def test_integers_beyond_64_bits_come_in_as_floats_with_and_without_nan_beside_them():
    for numeral in ("1" * 30, "18446744073709551616", "-9223372036854775809", "-" + "9" * 20):
        assert json.decode(f"[{numeral}]") == [float(numeral)]
        beside, _ = json.decode(f"[{numeral},NaN]")
        assert (beside, type(beside)) == (float(numeral), float)
    with pytest.raises(FrameError):
        json.decode("9" * 10_000)
    assert json.decode(f"[NaN,{'9' * 10_000}]")[1] == math.inf


def test_text_that_is_no_json_is_refused_with_a_position():
    for frame in ("", "{", '{"a":1}x', "{'a':1}", '"\\ud800"', "[NaN", '["\\ud800",NaN]', "[nan]"):
        with pytest.raises(FrameError, match=r"not JSON, .* at position ") as refusal:
            json.decode(frame)
        assert "\n" not in str(refusal.value)


def test_nesting_is_taken_to_the_limit_and_not_beyond_and_brackets_that_do_not_nest_are_taken():
    depth = json.MAX_NESTING_DEPTH - 1
    for encode, text, (opening, closing) in itertools.product(
        (str, str.encode), ("", "x" * 100_000), (("[", "]"), ('{"a":', "}"))
    ):
        assert json.decode(encode(f'["{text}",{opening * depth}1{closing * depth}]'))
        with pytest.raises(FrameError, match=f"limit of {json.MAX_NESTING_DEPTH}"):
            json.decode(encode(f'["{text}",{opening * (depth + 1)}1{closing * (depth + 1)}]'))
    for frame in ("[" * 200_000, "[NaN," + "[" * 200_000, "[NaN," + "[" * 5_000 + "]" * 5_001):
        with pytest.raises(FrameError):
            json.decode(frame)
    assert len(json.decode("[" + ",".join(["{}"] * 1000) + "]")) == 1000
    assert json.decode('"' + "[" * 1000 + '"') == "[" * 1000


def test_a_long_ascii_text_of_few_values_is_light():
    for text in ("x" * 2_000_000, "x" * 10_000 + "\\n" * 10_000, "x" * 10_000 + "," * 128):
        assert json.is_light(text)
    assert not json.is_light("x" * 2_200_000)
    for end in ("\\u00e9", "é", "," * 129, "[" * 129, "{" * 129):
        assert not json.is_light("x" * 10_000 + end), end


NO_MEMORY = """
import resource
from protocol.codecs import json

text = b'{"data": "%s"}' % (b"x" * (60 << 20))
with open("/proc/self/statm") as pages:
    mapped_bytes = int(pages.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (mapped_bytes + (20 << 20), resource.RLIM_INFINITY))
try:
    json._loads(text)
except MemoryError:
    print("no memory")
"""


def test_a_text_for_which_there_is_no_memory_does_not_end_the_process() -> None:
    done = run_python(NO_MEMORY)
    assert (done.returncode, done.stdout) == (0, "no memory\n")


texts = st.text(max_size=8)
long_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(texts, inner, max_size=6),
    max_leaves=60,
)
breaks = st.sampled_from([b"", b",", b"]", b"}", b"[", b"{", b'"', b"\\"])


def plain(piece: bytes, _offset: int) -> object:
    return orjson.loads(piece)


@given(long_values, st.integers(1, 40), st.sampled_from([None, 1]), breaks, st.data())
def test_what_is_decoded_or_refused_in_pieces_is_so_at_once(
    value: object, piece_bytes: int, indent: int, broken: bytes, data: st.DataObject
) -> None:
    text = stdlib_json.dumps(value, ensure_ascii=False, indent=indent).encode()
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

    text = stdlib_json.dumps(LONG).encode()
    assert decode_in_pieces(text, note, 64, 1000) == LONG
    assert max(lengths) < 1200
    assert sum(lengths) > len(text) - 2 * len(lengths)


def test_long_frames_are_read_and_refused_as_short_ones() -> None:
    numbers = json.decode(b"[" + b"1.5," * 100_000 + b"Infinity]")
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
            json.decode(text)


def test_an_object_that_names_a_key_twice_around_a_cut_does_no_harm() -> None:
    text = b'{"a":[' + b"1," * 10 + b'1],"b":1,"a":[' + b"2," * 10 + b"2]}"
    for piece_bytes in range(1, 60):
        try:
            decode_in_pieces(text, plain, 64, piece_bytes)
        except FrameError as error:
            assert "the same key twice" in str(error)  # noqa: PT017 - either way is fine, nothing else may happen


def test_other_threads_have_their_turn_between_the_pieces() -> None:
    text = stdlib_json.dumps([float(number) for number in range(500_000)]).encode()
    turns, done = 0, threading.Event()

    def decode() -> None:
        json.decode(text)
        done.set()

    thread = threading.Thread(target=decode)
    thread.start()
    while not done.wait(0.0):
        turns += 1
    join(thread)
    assert turns > 3


# Of a message the elements of a list are of one kind.
VALUES: st.SearchStrategy[Any] = st.recursive(
    st.integers(-(2**63), 2**63 - 1) | st.text(max_size=40) | st.booleans() | st.none(),
    lambda inner: (
        st.lists(st.integers(0, 9), max_size=40)
        | st.lists(st.text(max_size=9), max_size=20)
        | st.lists(st.dictionaries(st.text(max_size=3), inner, max_size=5), max_size=8)
        | st.dictionaries(st.text(max_size=3), inner, max_size=12)
    ),
    max_leaves=60,
)

MESH = {"vertices": [{"x": 0.1, "y": 0.2, "z": 0.3}] * 10_000, "triangles": [{"vertex_indices": [0, 1, 2]}] * 20_000}
SCENE = {"world": {"collision_objects": [{"id": "a", "meshes": [MESH]}, {"id": "b", "meshes": []}]}}


@examples(30)
@given(VALUES, st.integers(20, 300))
def test_pieces_together_are_the_whole_and_none_but_a_single_text_costs_more_than_the_limit(value, piece_bytes):
    encoded = []

    def encode(member: Any) -> bytes:
        encoded.append(member)
        return orjson.dumps(member)

    assert b"".join(encoded_pieces(value, json_notation(encode), piece_bytes)) == orjson.dumps(value)
    assert b"".join(encoded_pieces(value, cbor._NOTATION, piece_bytes)) == cbor2.dumps(value)
    for each in (each for each in encoded if isinstance(each, dict | list)):
        assert encoding_cost_bytes(each, piece_bytes + 1) <= piece_bytes
    frame = {"value": value, "many": [{"value": value}] * 1000}
    assert json.encode_in_pieces(frame) == json.encode(frame)
    assert cbor2.loads(cbor.encode(frame)) == frame
    # The cost of encoding is estimated without looking at everything.
    assert 0 <= encoding_cost_bytes(value, LARGE_BYTES) <= LARGE_BYTES
    for large in ([0.5] * 10_000, {"data": "x" * LARGE_BYTES}, [{"x": 1.0, "y": 1.0}] * 3000, [["x" * 100] * 10] * 100):
        assert encoding_cost_bytes([value, large], LARGE_BYTES) == LARGE_BYTES


def test_a_list_of_few_elements_with_a_mesh_is_cut() -> None:
    pieces = list(encoded_pieces(SCENE, json_notation(orjson.dumps)))
    assert orjson.loads(b"".join(pieces)) == orjson.loads(json.encode_in_pieces(SCENE)) == SCENE
    assert cbor2.loads(cbor.encode(SCENE)) == SCENE
    assert max(map(len, pieces)) < 20_000
