import base64
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import values
from protocol.errors import MessageError
from protocol.registry import PRIMITIVES

anything = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | st.just([]) | st.just({})


def test_every_primitive_type_has_a_converter_that_keeps_its_zero():
    for name in PRIMITIVES:
        zero = values.zero(name)
        assert values.converter(name)(zero) == zero
        assert values.list_converter(name)([zero, zero]) == [zero, zero]


@pytest.mark.parametrize("value", [True, "1.0", [], {}, 10**400])
def test_a_float_refuses_what_is_no_number_or_too_large(value):
    with pytest.raises(MessageError, match="wanted float64"):
        values.to_float64(value)


def test_float32_refuses_what_only_float64_holds_but_takes_infinity():
    with pytest.raises(MessageError, match=r"wanted float32, got 1e\+39"):
        values.to_float32(1e39)
    assert values.to_float32(math.inf) == math.inf
    assert values.list_converter("float32")([0.0, 1e39]) is None
    assert values.list_converter("float32")([0.0, math.inf]) == [0.0, math.inf]


@pytest.mark.parametrize("name", values.INTEGER_RANGES)
def test_an_integer_type_takes_its_whole_range_and_no_more(name):
    lowest, highest = values.INTEGER_RANGES[name]
    convert, convert_list = values.converter(name), values.list_converter(name)
    for value in (lowest, highest):
        assert convert(value) == value
        assert convert_list([value]) == [value]
    for value in (lowest - 1, highest + 1):
        with pytest.raises(MessageError, match=rf"wanted {name} \({lowest} to {highest}\)"):
            convert(value)
        assert convert_list([value]) is None


@pytest.mark.parametrize("value", [True, 1.5, math.nan, math.inf, "1", None, []])
def test_an_integer_refuses_what_is_not_whole(value):
    with pytest.raises(MessageError, match="wanted int32"):
        values.converter("int32")(value)


@pytest.mark.parametrize("value", [0, 1, 1.0, "true", None])
def test_bool_takes_only_true_and_false(value):
    assert values.to_bool(True) is True
    with pytest.raises(MessageError, match="wanted bool"):
        values.to_bool(value)


@pytest.mark.parametrize("name", ["string", "wstring"])
@pytest.mark.parametrize("value", [0, True, None, ["a"]])
def test_a_text_type_takes_only_text(name, value):
    assert values.converter(name)("a") == "a"
    with pytest.raises(MessageError, match=f"wanted {name}, got"):
        values.converter(name)(value)


@given(st.sampled_from(["string", "wstring"]), st.text(max_size=8), st.integers(1, 6))
def test_bounded_text_is_taken_exactly_if_it_has_no_more_characters(name, text, bound):
    convert, convert_list = values.converter(name, bound), values.list_converter(name, bound)
    if len(text) <= bound:
        assert convert(text) == text
        assert convert_list([text, ""]) == [text, ""]
        return
    with pytest.raises(MessageError, match=f"wanted {name} of at most {bound} characters, got {len(text)}$"):
        convert(text)
    assert convert_list(["", text]) is None


@given(st.sampled_from(sorted(PRIMITIVES)), st.lists(anything, max_size=4))
def test_the_quick_way_for_lists_agrees_with_the_slow_one(name, elements):
    quick = values.list_converter(name)(elements)
    if quick is not None:
        slow = values.to_list(elements, values.converter(name))
        assert [(type(value), repr(value)) for value in quick] == [(type(value), repr(value)) for value in slow]


@pytest.mark.parametrize(("name", "element"), [("float64", 1.0), ("int32", 1), ("string", "a"), ("bool", True)])
def test_a_converted_list_is_not_the_list_that_came(name, element):
    came = [element]
    assert values.list_converter(name)(came) is not came


def test_the_quick_way_leaves_truth_values_and_nulls_to_the_slow_one():
    assert values.list_converter("float64")([1.0, True]) is None
    assert values.list_converter("float64")([1.0, None]) is None
    assert values.list_converter("int32")([1, True]) is None


@given(st.binary())
def test_octets_are_the_same_as_base64_text_and_as_a_list(octets):
    assert values.to_octets(base64.b64encode(octets).decode(), "uint8[]") == octets
    assert values.to_octets(list(octets), "uint8[]") == octets


@pytest.mark.parametrize("text", ["AQID\nBA==\n", "AQ\r\nIDBA=="])
def test_octets_may_have_the_line_breaks_of_mime(text):
    assert values.to_octets(text, "uint8[]") == b"\x01\x02\x03\x04"


@pytest.mark.parametrize("value", ["AA=", "AAA", "A-_A", "AAAA ", "é", "no base64", 42, None, {}])
def test_octets_that_are_neither_base64_nor_a_list_are_refused(value):
    with pytest.raises(MessageError, match=r"wanted uint8\[\] as base64 text"):
        values.to_octets(value, "uint8[]")


@pytest.mark.parametrize("element", [-1, 256, True, "a", None])
def test_an_octet_out_of_range_is_named_by_its_index(element):
    with pytest.raises(MessageError) as refusal:
        values.to_octets([0, 0, element], "uint8[]")
    assert refusal.value.path == "[2]"
