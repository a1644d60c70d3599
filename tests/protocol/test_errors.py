from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import MAX_QUOTED_CHARACTERS, describe, one_line, shorten


def test_values_are_described_in_terms_of_json_and_long_ones_cut():
    described = {
        None: "null",
        True: "true",
        False: "false",
        1.5: "1.5",
        "a": "'a'",
        2**70: "an integer of 71 bits",
        10**5000: "an integer of 16610 bits",
    }
    assert {value: describe(value) for value in described} == described
    assert (describe({"a": 1}), describe([1, 2])) == ("an object of 1 fields", "a list of 2")
    assert (shorten("abc"), shorten("a" * 1000)) == ("abc", "a" * MAX_QUOTED_CHARACTERS + "...")


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


@given(st.text())
def test_whatever_the_text_it_becomes_one_line_without_control_characters(text):
    line = one_line(text)
    assert line.isprintable()
    assert line == text or not text.isprintable()
