import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import MAX_QUOTED_CHARACTERS, describe, one_line, shorten


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "null"),
        (True, "true"),
        (False, "false"),
        (1.5, "1.5"),
        ("a", "'a'"),
        ({"a": 1}, "an object of 1 fields"),
        ([1, 2], "a list of 2"),
        (2**70, "an integer of 71 bits"),
    ],
)
def test_values_are_described_in_terms_of_json(value, words):
    assert describe(value) == words


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


@given(json_values)
def test_a_description_is_one_short_line_whatever_came(value):
    words = describe(value)
    # Escapes may stretch what is quoted: \U0001f600 stands for one character.
    assert len(words) < 12 * MAX_QUOTED_CHARACTERS
    assert "\n" not in words


def test_long_digits_and_texts_are_cut():
    assert describe(10**5000) == "an integer of 16610 bits"
    assert shorten("abc") == "abc"
    assert shorten("a" * 1000) == "a" * MAX_QUOTED_CHARACTERS + "..."


@given(st.text())
def test_whatever_the_text_it_becomes_one_line_without_control_characters(text):
    line = one_line(text)
    assert line.isprintable()
    assert line == text or not text.isprintable()
