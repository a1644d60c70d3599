import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import MessageError
from protocol.limits import Limits
from protocol.publication import FRAME_OVERHEAD_BYTES, EncodedMessage, Frame
from protocol.send_queue import BEHIND_S, BULKY_BYTES, SendQueue
from protocol.subscriptions import Subscription


def send_queue(topic_frames=100, reply_frames=100, frame_bytes=10):
    size_bytes = frame_bytes + FRAME_OVERHEAD_BYTES
    return SendQueue(
        Limits.model_construct(
            max_queued_bytes=topic_frames * size_bytes, max_queued_reply_bytes=reply_frames * size_bytes
        )
    )


def frames(count, start=0):
    return [b"frame %04d" % number for number in range(start, start + count)]


def encoded(*frames):
    return EncodedMessage(*(Frame(frame, text=True) for frame in frames))


def taken(box, now, budget_bytes=10**9):
    return [frame.data for each in box.take_due(now, budget_bytes) for frame in each.frames]


def put_all(box, subscription, waiting):
    for frame in waiting:
        box.put_topic_data(subscription, encoded(frame), 0.0)


@pytest.fixture
def free():
    return Subscription("/free")


def test_requests_replies_and_topic_data_leave_once_in_order_of_queuing(free):
    box, other = send_queue(), Subscription("/other")
    box.put_topic_data(free, encoded(b"1"), 0.0)
    assert box.put_request(encoded(b"2"))
    box.put_topic_data(other, encoded(b"3"), 0.0)
    box.put_topic_data(free, encoded(b"4"), 0.0)
    box.put_reply(encoded(b"5"))
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0) == [b"1", b"2", b"3", b"4", b"5"]
    assert taken(box, 1.0) == []
    assert box.next_due(1.0) is None


def test_beyond_the_bound_the_oldest_topic_data_is_dropped_whatever_its_topic_and_no_reply(free):
    box, other = send_queue(topic_frames=4), Subscription("/other")
    box.put_reply(encoded(b"reply"))
    put_all(box, other, frames(2))
    put_all(box, free, frames(3, start=2))
    assert taken(box, 1.0) == [b"reply", *frames(3, start=2)]
    assert box.dropped == 2


def test_a_queue_length_keeps_the_newest_of_its_topic_only(free):
    box, short = send_queue(), Subscription("/short", queue_length=2)
    put_all(box, free, frames(3))
    put_all(box, short, frames(5, start=3))
    assert taken(box, 1.0) == frames(3) + frames(2, start=6)
    assert box.dropped == 3


def test_a_queue_that_was_shortened_is_cut_to_its_new_length():
    box, short = send_queue(), Subscription("/short", throttle_s=1.0, queue_length=5, last_sent_s=0.0)
    put_all(box, short, frames(5))
    short.queue_length = 2
    box.put_topic_data(short, encoded(b"newest"), 0.0)
    assert taken(box, 1.0) + taken(box, 2.0) + taken(box, 3.0) == [b"frame 0004", b"newest"]


def test_queued_messages_leave_one_per_throttle_interval_and_say_when():
    box, paced = send_queue(), Subscription("/paced", throttle_s=0.1, queue_length=10)
    put_all(box, paced, frames(3))
    assert taken(box, 5.0) == frames(1)
    assert box.next_due(5.0) == pytest.approx(5.1)
    assert taken(box, 5.05) == []
    assert taken(box, 5.11) == frames(1, start=1)
    assert taken(box, 9.0) == frames(1, start=2)
    assert box.next_due(9.0) is None


def test_a_throttled_topic_holds_nothing_else_back(free):
    box, paced = send_queue(), Subscription("/paced", throttle_s=1.0, queue_length=10, last_sent_s=4.5)
    box.put_topic_data(paced, encoded(b"later"), 0.0)
    box.put_topic_data(free, encoded(b"now"), 0.0)
    box.put_reply(encoded(b"reply"))
    assert taken(box, 5.0) == [b"now", b"reply"]
    assert box.next_due(5.0) == 5.5
    assert taken(box, 5.5) == [b"later"]


def test_messages_queued_for_a_closed_subscription_are_not_sent():
    box, paced = send_queue(), Subscription("/paced", throttle_s=1.0, queue_length=10, last_sent_s=4.5)
    put_all(box, paced, frames(3))
    paced.closed = True
    assert box.next_due(5.0) == 5.0
    assert taken(box, 5.0) == []
    assert box.next_due(5.0) is None


def test_replies_up_to_their_bound_are_kept_and_one_more_overflows():
    box = send_queue(reply_frames=3)
    for _ in range(3):
        for frame in frames(3):
            box.put_reply(encoded(frame))
        assert not box.overflowed
        assert taken(box, 1.0) == frames(3)
    for frame in frames(4):
        box.put_reply(encoded(frame))
    assert box.overflowed
    assert taken(box, 1.0) == frames(3)


steps = st.lists(st.tuples(st.sampled_from("abcdr-"), st.integers(min_value=0, max_value=600)), max_size=80)


@given(steps)
def test_order_and_bound_hold_whatever_comes(actions):
    limit_bytes = 2000
    box = SendQueue(Limits.model_construct(max_queued_bytes=limit_bytes, max_queued_reply_bytes=1_000_000))
    lanes = {
        "a": Subscription("/a"),
        "b": Subscription("/b", queue_length=2),
        "c": Subscription("/c", throttle_s=0.3, queue_length=3),
        "d": Subscription("/d", throttle_s=0.3, queue_length=100),
    }
    put = took = 0
    last_of = dict.fromkeys("abcdr", -1)
    for number, (action, size) in enumerate(actions):
        if action == "r":
            box.put_reply(encoded(b"r %d" % number))
        elif action in lanes:
            put += 1
            content = b"%s %d %s" % (action.encode(), number, b"x" * size)
            box.put_topic_data(lanes[action], encoded(content), 0.0)
        else:
            due = taken(box, number / 10)
            marks = [frame.split()[:2] for frame in due]
            numbers = [int(mark) for _, mark in marks]
            assert numbers == sorted(numbers)
            for lane, mark in marks:
                assert int(mark) > last_of[lane.decode()]
                last_of[lane.decode()] = int(mark)
                took += lane != b"r"
        count = len(box._free) + len(box._bulky) + len(box._paced)
        assert box._topic_bytes <= limit_bytes or count == 1
        assert put == took + box.dropped + count
        assert sum(map(len, box._waiting.values())) == count


# The budget


def test_a_budget_is_kept_to_within_one_message_and_the_rest_leaves_later_in_order(free):
    box, other = send_queue(), Subscription("/other")
    for number, frame in enumerate(frames(6)):
        if number % 3 == 2:
            box.put_reply(encoded(frame))
        else:
            box.put_topic_data((free, other)[number % 3], encoded(frame), 0.0)
    budget_bytes = 2 * (10 + FRAME_OVERHEAD_BYTES)
    assert taken(box, 1.0, budget_bytes) == frames(2)
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0, budget_bytes + 1) == frames(3, start=2)
    assert taken(box, 1.0, 1) == frames(1, start=5)
    assert box.next_due(1.0) is None


def test_the_fragments_of_a_message_leave_together_whatever_the_budget_and_are_dropped_together():
    box, short = send_queue(), Subscription("/short", queue_length=1)
    box.put_topic_data(short, encoded(b"1", b"2"), 0.0)
    box.put_topic_data(short, encoded(b"3", b"4"), 0.0)
    box.put_reply(encoded(b"5"))
    assert taken(box, 1.0, 1) == [b"3", b"4"]
    assert box.dropped == 1


# Requests


def test_requests_beyond_their_bound_are_refused_until_there_is_room():
    box = SendQueue(Limits.model_construct(max_queued_request_bytes=2 * encoded(b"1").size_bytes))
    assert [box.put_request(encoded(frame)) for frame in (b"1", b"2", b"3")] == [True, True, False]
    assert taken(box, 1.0) == [b"1", b"2"]
    assert box.put_request(encoded(b"4"))


def test_one_request_and_one_reply_may_have_any_size_and_take_no_room_from_each_other():
    box = SendQueue(Limits.model_construct(max_queued_request_bytes=1, max_queued_reply_bytes=1))
    assert box.put_request(encoded(b"x" * 1000))
    box.put_reply(encoded(b"x" * 1000))
    assert not box.overflowed
    box.put_reply(encoded(b"2"))
    assert box.overflowed


def test_messages_dropped_by_a_clients_own_throttle_are_counted_apart():
    box, paced = send_queue(topic_frames=2), Subscription("/paced", throttle_s=1.0, queue_length=1)
    put_all(box, paced, frames(3))
    assert (box.dropped, box.throttled) == (2, 2)
    put_all(box, Subscription("/free"), frames(3))
    assert box.dropped > box.throttled


def later(*frames: bytes) -> EncodedMessage:
    return EncodedMessage.later(lambda: encoded(*frames), 100)


def test_what_is_behind_a_message_that_is_still_to_be_encoded_waits_for_it() -> None:
    queue = SendQueue(Limits())
    large = later(b"large")
    queue.put_reply(large)
    queue.put_reply(encoded(b"small"))
    assert queue.take_unready() == [large]
    assert queue.take_unready() == []
    assert queue.take_due(0.0, 1000) == []
    assert queue.next_due(0.0) is None
    large.encode()
    assert queue.next_due(0.0) == 0.0
    assert [each.frames[0].data for each in queue.take_due(0.0, 1000)] == [b"large", b"small"]
    assert queue.empty
    assert queue.size_bytes == 0


@pytest.mark.parametrize("closed", [False, True])
def test_topic_data_that_waits_alone_leaves_once_it_is_encoded_unless_nobody_wants_it_any_more(closed: bool) -> None:
    queue, subscription, large = SendQueue(Limits()), Subscription("/a"), later(b"large")
    queue.put_topic_data(subscription, large, 0.0)
    assert queue.take_due(0.0, 1000) == []
    assert queue.next_due(0.0) is None
    subscription.closed = closed
    large.encode()
    assert taken(queue, 0.0) == ([] if closed else [b"large"])
    assert queue.next_due(0.0) is None


def test_a_message_that_could_not_be_encoded_holds_nobody_up() -> None:
    def fail() -> EncodedMessage:
        raise MessageError("a number", "nothing")

    queue, broken = SendQueue(Limits()), EncodedMessage.later(fail, 100)
    queue.put_reply(broken)
    queue.put_reply(encoded(b"next"))
    with pytest.raises(MessageError):
        broken.encode()
    assert [each.frames[0].data for each in queue.take_due(0.0, 1000)] == [b"next"]


# Messages that wait for long

DELAY_S = Limits().max_topic_delay_s


def test_a_subscription_that_is_too_far_behind_gets_the_newest(free: Subscription) -> None:
    box = SendQueue(Limits())
    for number in range(1000):
        box.put_topic_data(free, encoded(b"%d" % number), number / 100)
    numbers = [int(frame) for frame in taken(box, 10.0)]
    assert numbers == list(range(1000))[-len(numbers) :]
    assert len(numbers) == pytest.approx(100 * DELAY_S, abs=1)
    assert box.dropped == 1000 - len(numbers)


def test_one_burst_waits_as_long_as_the_client_reads_of_it(free: Subscription) -> None:
    box, other = SendQueue(Limits()), Subscription("/other")
    put_all(box, free, frames(30))
    for number in range(30):
        box.put_topic_data(other, encoded(b"now"), 2.0 * number)
        assert taken(box, 2.0 * number, 1) == frames(1, start=number)
    assert box.dropped > 0


def test_topic_data_is_dropped_of_a_client_that_stands_still_and_replies_stay(free: Subscription) -> None:
    box = SendQueue(Limits())
    put_all(box, free, frames(5))
    box.put_reply(encoded(b"reply"))
    box.put_topic_data(Subscription("/other"), encoded(b"new"), 1.0)
    box.drop_late(DELAY_S + 0.5)
    assert box.dropped == 5
    assert taken(box, DELAY_S + 0.5) == [b"reply", b"new"]


def test_messages_that_wait_for_the_clients_own_throttle_are_not_late() -> None:
    box = SendQueue(Limits())
    paced = Subscription("/paced", throttle_s=60.0, queue_length=10, last_sent_s=0.0)
    put_all(box, paced, frames(3))
    for now in (10.0, 60.0 + DELAY_S):
        box.drop_late(now)
        box.put_topic_data(paced, encoded(b"next"), now)
    assert box.dropped == 0
    box.drop_late(60.1 + DELAY_S)
    assert box.dropped == 4
    assert taken(box, 70.0) == [b"next"]


def test_no_more_small_messages_wait_than_are_given_up_quickly(free: Subscription) -> None:
    box = SendQueue(Limits.model_construct(max_queued_messages=100))
    put_all(box, free, frames(250))
    assert taken(box, 0.0) == frames(100, start=150)


def test_messages_of_a_topic_keep_their_order_when_its_throttle_comes_and_goes() -> None:
    box, topic = SendQueue(Limits()), Subscription("/t", queue_length=10)
    for number, throttle_s in enumerate((0.0, 0.3, 0.0, 0.3)):
        topic.throttle_s = throttle_s
        box.put_topic_data(topic, encoded(b"%d" % number), 0.0)
    assert [taken(box, now) for now in (1.0, 2.0, 3.0)] == [[b"0"], [b"1"], [b"2"]]
    topic.throttle_s = 0.0
    box.put_topic_data(topic, encoded(b"4"), 3.0)
    assert taken(box, 3.0) == [b"3", b"4"]
    assert box.empty


def test_what_waits_for_a_throttle_does_not_slow_down_what_may_leave(free: Subscription) -> None:
    box = SendQueue(Limits())
    paced = Subscription("/paced", throttle_s=60.0, queue_length=1000, last_sent_s=0.0)
    put_all(box, paced, frames(1000))
    box.put_topic_data(free, encoded(b"now"), 0.0)
    looked_at = []
    box._encoded = lambda sequence, look=box._encoded: looked_at.append(sequence) or look(sequence)
    assert taken(box, 1.0) == [b"now"]
    assert len(looked_at) == 1


# Small messages beside large ones

LARGE = b"x" * BULKY_BYTES


def test_small_messages_go_ahead_of_large_ones_of_other_topics_when_the_client_is_behind(free: Subscription) -> None:
    box, pictures = SendQueue(Limits()), Subscription("/pictures")
    put_all(box, pictures, [LARGE + b"%d" % number for number in range(30)])
    now = BEHIND_S + 0.1
    box.put_topic_data(free, encoded(b"joints"), now)
    box.put_reply(encoded(b"reply"))
    got = [frame[-6:] for _ in range(2) for frame in taken(box, now, 65_536)]
    assert b"joints" in got
    assert b"reply"[-6:] in got
    assert len(got) <= 4


def test_all_leave_in_order_of_queuing_while_the_client_keeps_up(free: Subscription) -> None:
    box = SendQueue(Limits())
    put_all(box, Subscription("/pictures"), [LARGE])
    put_all(box, free, [b"joints"])
    box.put_reply(encoded(b"reply"))
    assert taken(box, BEHIND_S) == [LARGE, b"joints", b"reply"]


def test_pictures_come_through_to_a_client_that_is_behind_with_small_messages_too(free: Subscription) -> None:
    box = SendQueue(Limits())
    put_all(box, Subscription("/pictures"), [LARGE] * 3)
    put_all(box, free, [b"y" * 30_000] * 100)
    got = [len(frame) for _ in range(8) for frame in taken(box, 1.0, 65_536)]
    assert got.count(len(LARGE)) >= 3
    assert got.count(30_000) >= 6


def test_messages_of_one_topic_keep_their_order_whatever_their_sizes() -> None:
    box, topic = SendQueue(Limits()), Subscription("/t")
    sent = [b"1", LARGE + b"2", b"3", LARGE + b"4", b"5"]
    put_all(box, topic, sent)
    got = []
    while due := taken(box, 1.0, 65_536):
        got += due
    assert got == sent


def test_small_messages_do_not_wait_for_a_large_one_whose_encoding_takes_long(free: Subscription) -> None:
    box, large = SendQueue(Limits()), EncodedMessage.later(lambda: encoded(LARGE), BULKY_BYTES)
    box.put_topic_data(Subscription("/pictures"), large, 0.0)
    box.put_topic_data(free, encoded(b"joints"), 0.0)
    assert taken(box, BEHIND_S) == []
    assert box.next_due(BEHIND_S) is None
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0) == [b"joints"]
    assert box.next_due(1.0) is None
    large.encode()
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0) == [LARGE]


def test_a_large_message_does_not_overtake_a_small_one_of_its_topic(free: Subscription) -> None:
    box, topic = SendQueue(Limits()), Subscription("/t")
    put_all(box, free, [LARGE, LARGE])
    assert taken(box, 1.0, 1) == [LARGE]
    put_all(box, topic, [b"1", LARGE + b"2"])
    got = []
    while due := taken(box, 1.0, 1):
        got += due
    assert got == [LARGE, b"1", LARGE + b"2"]
    put_all(box, free, [LARGE])
    assert taken(box, 1.0, 1) == [LARGE]
    put_all(box, topic, [b"1", LARGE + b"2"])
    assert taken(box, 1.0, 1) == [b"1"]


def test_a_message_may_wait_from_the_end_of_its_encoding(free: Subscription) -> None:
    box, large, again = SendQueue(Limits()), later(b"large"), later(b"again")
    box.put_topic_data(free, large, 0.0)
    box.drop_late(DELAY_S + 1.0)
    large.encode()
    box.drop_late(DELAY_S + 1.1)
    assert taken(box, DELAY_S + 1.1) == [b"large"]
    box.put_topic_data(free, again, 20.0)
    box.drop_late(21.0 + DELAY_S)
    again.encode()
    box.drop_late(21.1 + 2.0 * DELAY_S)
    assert (taken(box, 21.1 + 2.0 * DELAY_S), box.dropped) == ([], 1)
