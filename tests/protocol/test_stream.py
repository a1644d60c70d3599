import json

import bson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import FrameError
from protocol.framing import StreamSplitter
from tests.protocol.test_framing import operations, pieces

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
