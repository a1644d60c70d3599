import json as stdlib_json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import json
from protocol.errors import FrameError
from tests.helpers.programs import run_python

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


def test_characters_beyond_ascii_are_escaped_in_pairs_where_needed():
    assert json.encode({"ü": '€"😀'}) == b'{"\\u00fc":"\\u20ac\\"\\ud83d\\ude00"}'


def test_nan_and_infinities_go_out_as_null_and_their_tokens_come_in_as_floats():
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


@pytest.mark.parametrize("encode", [str, str.encode])
@pytest.mark.parametrize("text", ["", "x" * 100_000], ids=["short", "long"])
def test_nesting_is_taken_to_the_limit_and_not_beyond(encode, text):
    for opening, closing in (("[", "]"), ('{"a":', "}")):
        depth = json.MAX_NESTING_DEPTH - 1
        assert json.decode(encode(f'["{text}",{opening * depth}1{closing * depth}]'))
        with pytest.raises(FrameError, match=f"limit of {json.MAX_NESTING_DEPTH}"):
            json.decode(encode(f'["{text}",{opening * (depth + 1)}1{closing * (depth + 1)}]'))


def test_nesting_that_no_decoder_survives_is_refused_and_brackets_that_do_not_nest_are_taken():
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
