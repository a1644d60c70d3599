from typing import Any

import cbor2
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import cbor, json
from protocol.codecs.pieces import Notation, encoded_pieces, encoding_cost_bytes, json_notation

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
PIECE_BYTES = st.integers(20, 300)

MESH = {"vertices": [{"x": 0.1, "y": 0.2, "z": 0.3}] * 40_000, "triangles": [{"vertex_indices": [0, 1, 2]}] * 80_000}
SCENE = {"world": {"collision_objects": [{"id": "a", "meshes": [MESH]}, {"id": "b", "meshes": []}]}}


class Noting:
    """JSON's encoder, which notes the values that it gets."""

    def __init__(self) -> None:
        self.values: list[Any] = []

    def encode(self, value: Any) -> bytes:
        self.values.append(value)
        return orjson.dumps(value)


@given(VALUES, PIECE_BYTES)
def test_pieces_together_are_the_json_or_cbor_of_the_whole(value: Any, piece_bytes: int) -> None:
    notation: Notation = cbor._NOTATION
    assert b"".join(encoded_pieces(value, json_notation(orjson.dumps), piece_bytes)) == orjson.dumps(value)
    assert b"".join(encoded_pieces(value, notation, piece_bytes)) == cbor2.dumps(value)


@given(VALUES, PIECE_BYTES)
def test_no_piece_costs_more_than_the_limit_but_a_single_text(value: Any, piece_bytes: int) -> None:
    noting = Noting()
    list(encoded_pieces(value, json_notation(noting.encode), piece_bytes))
    for each in noting.values:
        if isinstance(each, dict | list):
            assert encoding_cost_bytes(each, piece_bytes + 1) <= piece_bytes


def test_a_list_of_few_elements_with_a_mesh_is_cut() -> None:
    noting = Noting()
    pieces = list(encoded_pieces(SCENE, json_notation(noting.encode)))
    assert orjson.loads(b"".join(pieces)) == SCENE
    assert max(map(len, pieces)) < 20_000


@pytest.mark.parametrize("encode", [json.encode_in_pieces, cbor.encode])
def test_a_mesh_in_pieces_is_the_mesh(encode: Any) -> None:
    decode: Any = orjson.loads if encode is json.encode_in_pieces else cbor2.loads
    assert decode(encode(SCENE)) == SCENE


@given(VALUES)
def test_a_frame_encoded_in_pieces_is_the_frame(value: Any) -> None:
    assert json.encode_in_pieces({"many": [{"value": value}] * 1000}) == json.encode(
        {"many": [{"value": value}] * 1000}
    )
