import json
import time

import bson as pymongo_bson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import FrameError
from protocol.framing import MAX_LEADING_BYTES, MAX_REFUSALS_PER_FRAME, FrameReader
from protocol.limits import Limits
from tests.helpers.examples import examples

operations = st.fixed_dictionaries(
    {
        "op": st.just("publish"),
        "msg": st.recursive(
            st.none() | st.integers(-100, 100) | st.text(st.sampled_from('ab"\\{}[]:,é😀\n')),
            lambda inner: st.lists(inner) | st.dictionaries(st.text(st.sampled_from('ab"\\{}')), inner),
            max_leaves=8,
        ),
    }
)


def read(*frames, limits=None):
    """All that is found in frames that come one after the other."""
    reader = FrameReader(limits or Limits())
    return [value for frame in frames for value in reader.feed(frame)]


def pieces(text, cuts):
    places = sorted({cut for cut in cuts if cut < len(text)})
    return [text[start:end] for start, end in zip([0, *places], [*places, len(text)], strict=True)]


@pytest.mark.parametrize("frame", ['{"op":"a"}', b'{"op":"a"}', ' \n{"op" : "a"} '])
def test_a_frame_that_is_one_object_is_read_at_once(frame):
    assert read(frame) == [{"op": "a"}]


@pytest.mark.parametrize("frame", ["42", "null", "[1]", '"text"'])
def test_a_value_that_is_no_object_is_handed_on_for_the_operation_to_be_refused(frame):
    assert read(frame) == [json.loads(frame)]


@given(st.lists(operations, min_size=2, max_size=5), st.sampled_from(["", " ", "\n", "garbage", "}]", "\\"]))
def test_several_objects_in_one_frame_are_found_in_order(several, between):
    assert read(between.join(map(json.dumps, several))) == several


@given(operations, st.lists(st.integers(1, 200), max_size=6), st.booleans())
def test_an_object_may_come_in_several_frames_cut_anywhere(operation, cuts, ascii_only):
    text = json.dumps(operation, ensure_ascii=ascii_only)
    assert read(*pieces(text.encode(), cuts)) == [operation]
    assert read(*pieces(text, cuts)) == [operation]


def test_what_follows_an_object_is_kept_for_the_next_frame():
    assert read('{"op":"a"}{"op":', '"b"}') == [{"op": "a"}, {"op": "b"}]


def test_an_object_in_the_middle_of_a_longer_one_belongs_to_it():
    assert read('{"op":"a","msg":', '{"data":1}', "}") == [{"op": "a", "msg": {"data": 1}}]


@pytest.mark.parametrize("garbage", ["hello ", "}}", "{bad} ", "{{{", '"', "]", "{ nothing", "\x00", "a:1,"])
def test_garbage_before_an_object_is_passed_over(garbage):
    assert read(garbage + '{"op":"a"}') == [{"op": "a"}]


@pytest.mark.parametrize("before", ["{", "x"])
def test_behind_too_much_garbage_nothing_is_looked_for(before):
    (error,) = read(before * MAX_LEADING_BYTES + ' {"op":"publish"}')
    assert isinstance(error, FrameError)


@pytest.mark.parametrize("garbage", ['{"a" ', '{"a', "{", '{"a":"'])
def test_an_operation_in_a_frame_of_its_own_ends_what_never_ended(garbage):
    refusal, operation = read(garbage, '{"op":"a"}')
    assert f"{len(garbage)} bytes" in str(refusal)
    assert operation == {"op": "a"}


@pytest.mark.parametrize("frame", ["", "hello", "[1", "}", b"\xff\xfe", "\ud800", "\ud800{"])
def test_a_frame_with_nothing_to_read_is_refused_once(frame):
    (refusal,) = read(frame)
    assert isinstance(refusal, FrameError)


def test_an_object_that_is_not_json_is_refused_and_the_next_one_read():
    refusal, operation = read('{"op":"a",}{"op":"b"}')
    assert "not JSON" in str(refusal)
    assert operation == {"op": "b"}


def test_nan_is_read_in_any_framing():
    (first, second) = read('{"a":1}{"a":NaN}')
    assert first == {"a": 1}
    assert second["a"] != second["a"]


def test_a_frame_of_too_many_objects_is_read_up_to_the_limit():
    found = read('{"op":"a"}' * 7, limits=Limits(max_objects_per_frame=5))
    assert found[:5] == [{"op": "a"}] * 5
    assert [str(refusal) for refusal in found[5:]] == ["20 bytes in which no object ends are given up"]


def test_a_frame_of_many_broken_objects_is_given_up_after_a_few():
    found = read('{"a",}' * 1000)
    assert len(found) == MAX_REFUSALS_PER_FRAME + 1


def test_an_object_longer_than_the_limit_is_given_up_and_reading_goes_on():
    limits = Limits(max_message_bytes=30)
    refusal, operation = read('{"op":"a","b":"', "x" * 20, '{"op":"c"}', limits=limits)
    assert "limit is 30" in str(refusal)
    assert operation == {"op": "c"}


@pytest.mark.parametrize("frame", ['{"a":' * 100 + "1" + "}" * 100, 'x{"a":' + "[" * 100 + "]" * 100 + "}"])
def test_deep_nesting_is_refused_in_any_framing(frame):
    assert "limit of 64 levels" in str(read(frame)[0])


def test_an_object_that_nests_too_deep_is_refused_before_its_end_has_come():
    assert "limit of 64 levels" in str(read('{"a":' * 100)[0])


def test_binary_frames_are_bson_or_json_each_by_its_own_look():
    reader = FrameReader(Limits())
    assert not reader.last_was_bson
    assert reader.feed(pymongo_bson.encode({"op": "a"})) == [{"op": "a"}]
    assert reader.last_was_bson
    assert reader.feed(b'{"op":"b"}') == [{"op": "b"}]
    assert not reader.last_was_bson


def test_a_broken_bson_document_is_refused_and_answered_in_kind():
    reader = FrameReader(Limits())
    (refusal,) = reader.feed(b"\x08\x00\x00\x00\xff\xff\xff\x00")
    assert "not BSON" in str(refusal)
    assert reader.last_was_bson


@examples(300)
@given(st.lists(st.text(st.sampled_from('{}[]":,\\ aé1')) | st.binary(max_size=12), max_size=6))
def test_whatever_comes_the_next_operation_is_read(frames):
    assert read(*frames, '{"op":"a"}')[-1] == {"op": "a"}


HOSTILE = [
    "{",
    '{"a":',
    '"',
    '{"',
    '{"a\\"',
    "{}",
    "[{},",
    "[{{}},",
    '["",',
    "{  ",
    "}",
    '{"a":[',
    '{"":"\\\\',
    '{"\\',
    '{"a",}',
]


def seconds_for(text):
    best = float("inf")
    for _ in range(3):
        reader = FrameReader(Limits())
        started = time.thread_time()
        reader.feed('{"a":')
        reader.feed(text)
        best = min(best, time.thread_time() - started)
    return best


@pytest.mark.parametrize("unit", HOSTILE)
def test_hostile_frames_take_time_in_proportion_to_their_length(unit):
    short, long = (seconds_for(unit * (size // len(unit))) for size in (50_000, 800_000))
    # Sixteen times the length; a quadratic reader would take 256 times as long. The floor is the clock's noise.
    assert long < 64 * max(short, 0.001)


def test_an_object_in_very_many_frames_takes_time_in_proportion_to_its_length():
    reader = FrameReader(Limits())
    started = time.thread_time()
    reader.feed('{"a":["')
    for _ in range(20_000):
        reader.feed('",{"b":1},"')
    # Reading it anew with each frame would look at two gigabytes.
    assert time.thread_time() - started < 5
