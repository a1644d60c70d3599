import contextlib
import json
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import OperationError
from protocol.fragments import Reassembly, split
from protocol.limits import Limits
from protocol.operations import Fragment


def fragment(num=0, total=2, data="x", mark="m"):
    return Fragment(id=mark, data=data, num=num, total=total)


def reassembly(**limits):
    return Reassembly(Limits(**limits))


def outcome(receiver, *operations, now=0.0):
    return [receiver.add(operation, now) for operation in operations]


@given(st.text(min_size=1), st.integers(1, 50), st.randoms(use_true_random=False))
def test_what_is_split_is_put_together_in_any_order(text, size, source):
    frames = [json.loads(frame) for frame in split(text, size, "7")]
    source.shuffle(frames)
    results = outcome(reassembly(), *map(Fragment.model_validate, frames))
    assert results == [None] * (len(frames) - 1) + [text]


@given(st.text(min_size=1), st.integers(1, 50))
def test_pieces_are_numbered_in_integers_and_no_longer_than_wanted(text, size):
    frames = split(text, size, "7")
    for number, frame in enumerate(frames):
        assert frame.isascii()
        piece = json.loads(frame)
        assert list(piece) == ["op", "id", "data", "num", "total"]
        assert (piece["id"], piece["num"], piece["total"]) == ("7", number, len(frames))
        assert type(piece["total"]) is int
        assert len(piece["data"]) <= size


def test_messages_may_be_interleaved():
    receiver = reassembly()
    operations = [fragment(0, mark="a"), fragment(0, mark="b"), fragment(1, mark="b", data="y"), fragment(1, mark="a")]
    assert outcome(receiver, *operations) == [None, None, "xy", "xx"]


def test_a_fragment_that_comes_twice_changes_nothing():
    assert outcome(reassembly(), fragment(0), fragment(0, data="other"), fragment(1)) == [None, None, "xx"]


def test_a_fragment_that_comes_twice_costs_nothing_either():
    receiver = reassembly(max_message_bytes=2, max_fragments=2)
    assert outcome(receiver, fragment(0), fragment(0), fragment(0), fragment(1)) == [None, None, None, "xx"]


def test_an_id_can_be_used_again_for_the_next_message():
    receiver = reassembly()
    assert outcome(receiver, fragment(0), fragment(1), fragment(0), fragment(1)) == [None, "xx", None, "xx"]


@pytest.mark.parametrize("num", [2, 10**9])
def test_a_number_outside_of_the_total_is_refused(num):
    with pytest.raises(OperationError, match="fragment: field num"):
        reassembly().add(fragment(num, 2), 0.0)


def test_fragments_that_disagree_about_their_total_lose_their_message():
    receiver = reassembly()
    receiver.add(fragment(0, 3), 0.0)
    with pytest.raises(OperationError, match="field total"):
        receiver.add(fragment(1, 2), 0.0)
    assert outcome(receiver, fragment(0, 2), fragment(1, 2)) == [None, "xx"]


def test_a_message_of_too_many_fragments_is_refused():
    with pytest.raises(OperationError, match="the limit is 5"):
        reassembly(max_fragments=5).add(fragment(0, 6), 0.0)


def test_too_many_messages_at_a_time_are_refused():
    receiver = reassembly(max_fragmented_messages=2)
    outcome(receiver, fragment(mark="a"), fragment(mark="b"))
    with pytest.raises(OperationError, match="2 messages wait"):
        receiver.add(fragment(mark="c"), 0.0)
    assert receiver.add(fragment(1, mark="a"), 0.0) == "xx"


def test_too_many_fragments_over_all_messages_are_refused():
    receiver = reassembly(max_fragments=3)
    outcome(receiver, fragment(0, 3, mark="a"), fragment(1, 3, mark="a"), fragment(0, 3, mark="b"))
    with pytest.raises(OperationError, match="3 fragments wait"):
        receiver.add(fragment(1, 3, mark="b"), 0.0)


@pytest.mark.parametrize("data", ["x" * 11, "é" * 6])
def test_too_many_bytes_are_refused_and_room_is_made_again(data):
    receiver = reassembly(max_message_bytes=20)
    receiver.add(fragment(0, 3, "x" * 10), 0.0)
    with pytest.raises(OperationError, match="the limit is 20"):
        receiver.add(fragment(1, 3, data), 0.0)
    assert outcome(receiver, fragment(0, 2, "x" * 10), fragment(1, 2, "x" * 10)) == [None, "x" * 20]


def test_a_message_that_is_not_completed_in_time_is_forgotten():
    receiver = reassembly(fragment_timeout_s=10.0)
    receiver.add(fragment(0), 0.0)
    assert receiver.add(fragment(1), 10.1) is None
    assert receiver.add(fragment(0), 10.2) == "xx"


def test_a_message_that_is_completed_just_in_time_is_whole():
    receiver = reassembly(fragment_timeout_s=10.0)
    receiver.add(fragment(0), 0.0)
    assert receiver.add(fragment(1), 10.0) == "xx"


def test_whatever_comes_the_bounds_hold():
    receiver = reassembly(max_fragments=20, max_fragmented_messages=3, max_message_bytes=100)
    source = random.Random(1)
    for now in range(5000):
        one = fragment(source.randint(0, 9), source.randint(1, 30), "x" * source.randint(0, 30), source.choice("abcde"))
        with contextlib.suppress(OperationError):
            receiver.add(one, float(now))
        waiting = receiver._messages.values()
        assert len(waiting) <= 3
        assert receiver._fragments == sum(len(message.pieces) for message in waiting) <= 20
        assert receiver._size_bytes == sum(len(text) for each in waiting for text in each.pieces.values()) <= 100
