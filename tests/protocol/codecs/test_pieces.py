from typing import Any

import cbor2
import orjson
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import cbor, json
from protocol.codecs.pieces import encoded_pieces, encoding_cost_bytes, json_notation
from protocol.publication import LARGE_BYTES
from tests.helpers.resources import examples

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


@given(VALUES, st.integers(20, 300))
def test_pieces_together_are_the_whole_and_none_costs_more_than_the_limit(value: Any, piece_bytes: int) -> None:
    encoded = []

    def encode(member: Any) -> bytes:
        encoded.append(member)
        return orjson.dumps(member)

    assert b"".join(encoded_pieces(value, json_notation(encode), piece_bytes)) == orjson.dumps(value)
    assert b"".join(encoded_pieces(value, cbor._NOTATION, piece_bytes)) == cbor2.dumps(value)
    for each in (each for each in encoded if isinstance(each, dict | list)):
        assert encoding_cost_bytes(each, piece_bytes + 1) <= piece_bytes


@examples(30)
@given(VALUES)
def test_a_frame_encoded_in_pieces_is_the_frame(value: Any) -> None:
    frame = {"value": value, "many": [{"value": value}] * 1000}
    assert json.encode_in_pieces(frame) == json.encode(frame)
    assert cbor2.loads(cbor.encode(frame)) == frame


def test_a_list_of_few_elements_with_a_mesh_is_cut() -> None:
    pieces = list(encoded_pieces(SCENE, json_notation(orjson.dumps)))
    assert orjson.loads(b"".join(pieces)) == orjson.loads(json.encode_in_pieces(SCENE)) == SCENE
    assert cbor2.loads(cbor.encode(SCENE)) == SCENE
    assert max(map(len, pieces)) < 20_000


@examples(30)
@given(VALUES)
def test_the_cost_of_encoding_is_estimated_without_looking_at_everything(value: Any) -> None:
    assert 0 <= encoding_cost_bytes(value, LARGE_BYTES) <= LARGE_BYTES
    for large in ([0.5] * 10_000, {"data": "x" * LARGE_BYTES}, [{"x": 1.0, "y": 1.0}] * 3000, [["x" * 100] * 10] * 100):
        assert encoding_cost_bytes([value, large], LARGE_BYTES) == LARGE_BYTES
