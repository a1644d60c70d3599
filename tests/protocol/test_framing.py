import contextlib
import json
import random

import bson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import FrameError, OperationError
from protocol.framing import Reassembly, StreamSplitter, split
from protocol.limits import Limits
from protocol.operations import Fragment
from protocol.session import MAX_LEADING_BYTES, MAX_REFUSALS_PER_FRAME, FrameReader
from tests.helpers.resources import examples

messages = st.recursive(
    st.none() | st.integers(-100, 100) | st.text(st.sampled_from('ab"\\{}[]:,é😀\n')),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(st.sampled_from('ab"\\{}')), inner),
    max_leaves=8,
)
operations = st.fixed_dictionaries({"op": st.just("publish"), "msg": messages})


def read(*frames, limits=None):
    """All that is found in frames that come one after the other."""
    reader = FrameReader(limits or Limits())
    return [value for frame in frames for value in reader.feed(frame)]


def pieces(text, cuts):
    places = sorted({cut for cut in cuts if cut < len(text)})
    return [text[start:end] for start, end in zip([0, *places], [*places, len(text)], strict=True)]


@given(st.lists(operations, min_size=2, max_size=5), st.sampled_from(["", " ", "\n", "garbage", "}]", "\\"]))
def test_several_objects_in_one_frame_are_found_in_order(several, between):
    assert read(between.join(map(json.dumps, several))) == several


@given(operations, st.lists(st.integers(1, 200), max_size=6), st.booleans())
def test_an_object_may_come_in_several_frames_cut_anywhere(operation, cuts, ascii_only):
    text = json.dumps(operation, ensure_ascii=ascii_only)
    assert read(*pieces(text.encode(), cuts)) == [operation]
    assert read(*pieces(text, cuts)) == [operation]


def test_an_object_in_the_middle_of_a_longer_one_belongs_to_it():
    assert read('{"op":"a","msg":', '{"data":1}', "}") == [{"op": "a", "msg": {"data": 1}}]


def test_garbage_before_an_object_is_passed_over_unless_there_is_too_much():
    for garbage in ("hello ", "}}", "{bad} ", "{{{", '"', "]", "{ nothing", "\x00", "a:1,"):
        assert read(garbage + '{"op":"a"}') == [{"op": "a"}], garbage
    for before in "{x":
        (error,) = read(before * MAX_LEADING_BYTES + ' {"op":"publish"}')
        assert isinstance(error, FrameError)


def test_an_operation_in_a_frame_of_its_own_ends_what_never_ended_or_is_longer_than_the_limit():
    for garbage in ('{"a" ', '{"a', "{", '{"a":"'):
        refusal, operation = read(garbage, '{"op":"a"}')
        assert f"{len(garbage)} bytes" in str(refusal)
        assert operation == {"op": "a"}
    limits = Limits.model_construct(max_message_bytes=30)
    refusal, operation = read('{"op":"a","b":"', "x" * 20, '{"op":"c"}', limits=limits)
    assert "limit is 30" in str(refusal)
    assert operation == {"op": "c"}


def test_a_frame_with_nothing_to_read_is_refused_once_and_many_or_broken_objects_are_given_up_at_the_limit():
    for frame in ("", "hello", "[1", "}", b"\xff\xfe", "\ud800", "\ud800{"):
        (refusal,) = read(frame)
        assert isinstance(refusal, FrameError)
    found = read('{"op":"a"}' * 7, limits=Limits.model_construct(max_objects_per_frame=5))
    assert found[:5] == [{"op": "a"}] * 5
    assert [str(refusal) for refusal in found[5:]] == ["20 bytes in which no object ends are given up"]
    assert len(read('{"a",}' * 1000)) == MAX_REFUSALS_PER_FRAME + 1


def test_deep_nesting_is_refused_in_any_framing():
    for frame in ('{"a":' * 100 + "1" + "}" * 100, 'x{"a":' + "[" * 100 + "]" * 100 + "}", '{"a":' * 100):
        assert "limit of 64 levels" in str(read(frame)[0]), frame


def test_a_broken_bson_document_is_refused_and_answered_in_kind():
    reader = FrameReader(Limits())
    (refusal,) = reader.feed(b"\x08\x00\x00\x00\xff\xff\xff\x00")
    assert "not BSON" in str(refusal)
    assert reader.last_was_bson


@examples(300)
@given(st.lists(st.text(st.sampled_from('{}[]":,\\ aé1')) | st.binary(max_size=12), max_size=6))
def test_whatever_comes_the_next_operation_is_read(frames):
    assert read(*frames, '{"op":"a"}')[-1] == {"op": "a"}


def fragment(num=0, total=2, data="x", mark="m"):
    return Fragment(id=mark, data=data, num=num, total=total)


def outcome(receiver, *operations):
    return [receiver.add(operation, 0.0) for operation in operations]


@given(st.text(min_size=1), st.integers(1, 50), st.randoms(use_true_random=False))
def test_fragments_are_reassembled_in_any_order(text, size, source):
    frames = [json.loads(frame) for frame in split(text, size, "7")]
    source.shuffle(frames)
    results = outcome(Reassembly(Limits()), *map(Fragment.model_validate, frames))
    assert results == [None] * (len(frames) - 1) + [text]


def test_a_fragment_that_comes_twice_costs_nothing_either():
    receiver = Reassembly(Limits.model_construct(max_message_bytes=2, max_fragments=2))
    assert outcome(receiver, fragment(0), fragment(0), fragment(0), fragment(1)) == [None, None, None, "xx"]


def test_what_goes_beyond_a_limit_is_refused_with_its_message_and_other_messages_stay():
    two, three = [fragment(), fragment(mark="b")], [fragment(), fragment(0, 3, mark="a"), fragment(1, 3, mark="a")]
    for limits, taken, refused, words, complete in (
        ({"max_fragments": 5}, [fragment()], fragment(0, 6, mark="a"), "the limit is 5", [fragment(1)]),
        ({"max_fragmented_messages": 2}, two, fragment(mark="c"), "2 messages wait", [fragment(1)]),
        ({"max_fragments": 3}, three, fragment(2, 3, mark="a"), "3 fragments wait", [fragment(1)]),
        # Room is made again.
        ({"max_message_bytes": 2}, [fragment(0, 3)], fragment(1, 3, "é"), "limit is 2", [fragment(0), fragment(1)]),
    ):
        receiver = Reassembly(Limits.model_construct(**limits))
        outcome(receiver, *taken)
        with pytest.raises(OperationError, match=words):
            receiver.add(refused, 0.0)
        assert outcome(receiver, *complete)[-1] == "xx", words


def test_a_message_is_completed_in_time_or_forgotten():
    receiver = Reassembly(Limits.model_construct(fragment_timeout_s=10.0))
    receiver.add(fragment(0), 0.0)
    assert receiver.add(fragment(1), 10.0) == "xx"
    receiver.add(fragment(0), 20.0)
    assert receiver.add(fragment(1), 30.1) is None
    assert receiver.add(fragment(0), 30.2) == "xx"


def test_whatever_comes_the_bounds_hold():
    receiver = Reassembly(Limits.model_construct(max_fragments=20, max_fragmented_messages=3, max_message_bytes=100))
    source = random.Random(1)
    for now in range(5000):
        one = fragment(source.randint(0, 9), source.randint(1, 30), "x" * source.randint(0, 30), source.choice("abcde"))
        with contextlib.suppress(OperationError):
            receiver.add(one, float(now))
        waiting = receiver._messages.values()
        assert len(waiting) <= 3
        assert receiver._fragments == sum(len(message.pieces) for message in waiting) <= 20
        assert receiver._size_bytes == sum(len(text) for each in waiting for text in each.pieces.values()) <= 100


LIMIT = 10_000
DOCUMENT = bson.encode({"op": "x"})


def frames_of(*data: bytes, limit: int = LIMIT) -> tuple[list[bytes], str | None]:
    """Every frame of a stream that comes in pieces, and the sentence that ended it."""
    splitter, frames = StreamSplitter(limit), []
    try:
        for piece in data:
            splitter.add(piece)
            while (frame := splitter.next_frame()) is not None:
                assert isinstance(frame, bytes) or not splitter.is_bson
                frames.append(frame.encode() if isinstance(frame, str) else frame)
    except FrameError as error:
        return frames, str(error)
    return frames, None


several_operations, cuts = st.lists(operations, min_size=1, max_size=5), st.lists(st.integers(1, 400), max_size=8)


@given(several_operations, cuts, st.sampled_from(["", "\n", " \r\n\t", "\0", "\0\0\0"]))
def test_json_objects_and_bson_documents_are_found_in_order_however_the_stream_is_cut(several, cuts, between):
    texts = [json.dumps(operation, ensure_ascii=False).encode() for operation in several]
    assert frames_of(*pieces(between.encode().join(texts) + between.encode(), cuts)) == (texts, None)
    documents = [bson.encode(operation) for operation in several]
    assert frames_of(*pieces(b"".join(documents), cuts)) == (documents, None)


@given(
    st.binary(max_size=300) | st.lists(st.sampled_from([b"{", b"}", b'"', b"\\", b"\0", b"\x05", b"a"])).map(b"".join)
)
def test_garbage_gives_the_same_frames_and_the_same_end_byte_by_byte(data):
    at_once, end = frames_of(data, limit=100)
    one_by_one, later_end = frames_of(*(data[at : at + 1] for at in range(len(data))), limit=100)
    assert at_once == one_by_one
    assert (end is None) == (later_end is None)


def test_an_object_that_is_as_long_as_its_own_brace_says_is_told_from_json():
    # A document of 123 bytes begins as an object does.
    document = bson.encode({"op": "publish", "x": "y" * 94})
    assert document[:1] == b"{"
    assert frames_of(document) == ([document], None)


def test_an_operation_inside_of_an_object_that_comes_as_a_piece_of_its_own_stays_inside():
    stream = [b'{"op":"publish","topic":"/t","msg":', b'{"op":"x"}', b"}"]
    assert frames_of(*stream) == ([b"".join(stream)], None)


def test_a_length_outside_of_the_limits_is_named_behind_the_frames_before_it():
    for before, lengths in (([], (0, 4, LIMIT + 1, 2**26)), ([DOCUMENT], (-1, -(2**31), 4, LIMIT + 1, 2**31 - 1))):
        for length in lengths:
            frames, end = frames_of(b"".join(before) + length.to_bytes(4, "little", signed=True))
            assert frames == before
            assert f"of {length} bytes, the limits are 5 and {LIMIT}" in str(end)


@pytest.mark.parametrize(("pieces", "size"), [(1, "10001"), (2, "more than 10001")])
def test_an_object_beyond_the_limit_is_refused_before_it_has_come_to_its_end(pieces, size):
    longest = b'{"op":"%b"}' % (b"x" * (LIMIT - 9))
    assert frames_of(longest) == ([longest], None)
    longer = longest.replace(b'x"}', b'xx"}' if pieces == 1 else b"xxxx")
    assert f"a JSON object of {size} bytes, the limit is {LIMIT}" in str(frames_of(longer)[1])


def test_a_lowered_limit_counts_from_the_next_frame_on():
    splitter = StreamSplitter(LIMIT)
    splitter.add(b'{"op":"long enough"}')
    splitter.max_frame_bytes = 10
    with pytest.raises(FrameError, match="limit is 10"):
        splitter.next_frame()


def test_what_belongs_nowhere_ends_the_stream_and_little_of_it_is_shown():
    for stream in (b"POST / HTTP/1.1\r\n\r\n", b"[1]  ", b"secret-token-0123456789", b"\x80\x81\x82\x83"):
        frames, end = frames_of(stream + b'{"op":"publish"}')
        assert frames == []
        assert "wanted a JSON object, or a BSON document" in str(end)
        assert "token" not in str(end)
    for stream, before, words in (
        (b'{"op":"a"}, {"op":"b"}', [b'{"op":"a"}'], "between JSON objects"),
        (b'{"a":' * 1000, [], "nested deeper"),
        # A stream of BSON stays BSON.
        (DOCUMENT + b'{"op":"x"}', [DOCUMENT], "a BSON document of"),
        (DOCUMENT[:-1] + b"\x01", [], "does not end with zero"),
    ):
        frames, end = frames_of(stream)
        assert frames == before
        assert words in str(end)


def test_an_object_comes_as_text_and_one_that_is_no_utf8_as_bytes_to_be_refused():
    splitter = StreamSplitter(LIMIT)
    splitter.add('{"op":"é"}'.encode() + b'{"op":"\xff"}')
    assert [splitter.next_frame(), splitter.next_frame()] == ['{"op":"é"}', b'{"op":"\xff"}']
