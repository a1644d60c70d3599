import base64
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import values
from protocol.errors import MessageError
from protocol.registry import PRIMITIVES

anything = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | st.just([]) | st.just({})


def refusal(convert, *arguments):
    with pytest.raises(MessageError) as refused:
        convert(*arguments)
    return refused.value


def test_every_primitive_type_has_a_converter_that_keeps_its_zero():
    for name in PRIMITIVES:
        zero = values.zero(name)
        assert values.converter(name)(zero) == zero
        quick = values.list_converter(name)([zero, zero])
        assert quick == ([zero, zero] if name != "uint64" else None)


def test_each_type_refuses_what_is_of_another_kind_or_too_large():
    assert values.to_bool(True) is True
    assert values.converter("string")("a") == values.converter("wstring")("a") == "a"
    for name, others in {
        "float64": (True, "1.0", [], {}, 10**400),
        "int32": (True, 1.5, math.nan, math.inf, "1", None, []),
        "bool": (0, 1, 1.0, "true", None),
        "string": (0, True, None, ["a"]),
        "wstring": (0, True, None, ["a"]),
    }.items():
        for value in others:
            assert f"wanted {name}" in str(refusal(values.converter(name), value)), value
    assert "wanted float32, got 1e+39" in str(refusal(values.converter("float32"), 1e39))
    assert values.to_float32(math.inf) == math.inf
    assert values.list_converter("float32")([0.0, 1e39]) is None
    assert values.list_converter("float32")([0.0, math.inf]) == [0.0, math.inf]


def test_an_integer_type_takes_its_whole_range_and_no_more():
    for name, (lowest, highest) in values.INTEGER_RANGES.items():
        convert, convert_list = values.converter(name), values.list_converter(name)
        for value in (lowest, highest):
            assert convert(value) == value, name
            assert convert_list([value]) == ([value] if name != "uint64" else None), name
        for value in (lowest - 1, highest + 1):
            assert f"wanted {name} ({lowest} to {highest})" in str(refusal(convert, value))
            assert convert_list([value]) is None, name


@given(st.sampled_from(["string", "wstring"]), st.text(max_size=8), st.integers(1, 6))
def test_bounded_text_is_taken_exactly_if_it_has_no_more_characters(name, text, bound):
    convert, convert_list = values.converter(name, bound), values.list_converter(name, bound)
    if len(text) <= bound:
        assert (convert(text), convert_list([text, ""])) == (text, [text, ""])
    else:
        wanted = f"wanted {name} of at most {bound} characters, got {len(text)}"
        assert str(refusal(convert, text)).endswith(wanted)
        assert convert_list(["", text]) is None


@given(st.sampled_from(sorted(PRIMITIVES)), st.lists(anything, max_size=4))
def test_the_quick_way_for_lists_agrees_with_the_slow_one(name, elements):
    quick = values.list_converter(name)(elements)
    if quick is not None:
        slow = values.to_list(elements, values.converter(name))
        assert [(type(value), repr(value)) for value in quick] == [(type(value), repr(value)) for value in slow]
        assert quick is not elements


def test_the_quick_way_leaves_truth_values_and_nulls_to_the_slow_one():
    for name, elements in (("float64", [1.0, True]), ("float64", [1.0, None]), ("int32", [1, True])):
        assert values.list_converter(name)(elements) is None


@given(st.binary())
def test_octets_are_the_same_as_base64_text_perhaps_with_the_line_breaks_of_mime_and_as_a_list(octets):
    in_lines = base64.encodebytes(octets)
    for text in (base64.b64encode(octets), in_lines, in_lines.replace(b"\n", b"\r\n")):
        assert values.to_octets(text.decode(), "uint8[]") == octets
    assert values.to_octets(list(octets), "uint8[]") == octets


def test_octets_that_are_neither_base64_nor_a_list_or_out_of_range_are_refused():
    for value in ("AA=", "AAA", "A-_A", "AAAA ", "é", "no base64", 42, None, {}):
        assert "wanted uint8[] as base64 text" in str(refusal(values.to_octets, value, "uint8[]"))
    for element in (-1, 256, True, "a", None):
        assert refusal(values.to_octets, [0, 0, element], "uint8[]").path == "[2]"
