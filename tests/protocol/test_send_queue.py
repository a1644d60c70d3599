import pytest

from protocol.errors import MessageError
from protocol.limits import Limits
from protocol.publication import FRAME_OVERHEAD_BYTES, EncodedMessage, Frame
from protocol.send_queue import BEHIND_S, BULKY_BYTES, SendQueue
from protocol.subscriptions import Subscription
from tests.helpers.cost import count_calls

FRAME_BYTES = 10 + FRAME_OVERHEAD_BYTES
DELAY_S = Limits().max_topic_delay_s


def send_queue(**limits):
    return SendQueue(Limits.model_construct(**limits))


def frames(count, start=0):
    return [b"frame %04d" % number for number in range(start, start + count)]


def encoded(*frames):
    return EncodedMessage(*(Frame(frame, text=True) for frame in frames))


def later(*frames, size_bytes=100):
    return EncodedMessage.later(lambda: encoded(*frames), size_bytes)


def taken(box, now, budget_bytes=10**9):
    return [frame.data for each in box.take_due(now, budget_bytes) for frame in each.frames]


def put(box, subscription, *waiting, now=0.0):
    for frame in waiting:
        box.put_topic_data(subscription, frame if isinstance(frame, EncodedMessage) else encoded(frame), now)


def reply(box, *frames):
    for frame in frames:
        box.put_reply(encoded(frame))


def paced(last_sent_s=0.0, throttle_s=1.0, queue_length=10):
    return Subscription("/paced", throttle_s=throttle_s, queue_length=queue_length, last_sent_s=last_sent_s)


@pytest.fixture
def free():
    return Subscription("/free")


@pytest.fixture
def other():
    return Subscription("/other")


def test_requests_replies_and_topic_data_leave_once_in_order_of_queuing(free, other):
    box = send_queue()
    put(box, free, b"1")
    assert box.put_request(encoded(b"2"))
    put(box, other, b"3")
    put(box, free, b"4")
    reply(box, b"5")
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0) == [b"1", b"2", b"3", b"4", b"5"]
    assert (taken(box, 1.0), box.next_due(1.0)) == ([], None)


def test_beyond_the_bound_the_oldest_topic_data_is_dropped_whatever_its_topic_and_no_reply(free, other):
    box = send_queue(max_queued_bytes=4 * FRAME_BYTES)
    reply(box, b"reply")
    put(box, other, *frames(2))
    put(box, free, *frames(3, start=2))
    assert taken(box, 1.0) == [b"reply", *frames(3, start=2)]
    assert box.dropped == 2
    # So many small ones as can be given up quickly.
    box = send_queue(max_queued_messages=100)
    put(box, free, *frames(250))
    assert taken(box, 0.0) == frames(100, start=150)


def test_a_queue_length_keeps_the_newest_of_its_topic_only_also_when_it_is_shortened(free):
    box, short = send_queue(), Subscription("/short", queue_length=2)
    put(box, free, *frames(3))
    put(box, short, *frames(5, start=3))
    assert taken(box, 1.0) == frames(3) + frames(2, start=6)
    assert box.dropped == 3
    short = paced(queue_length=5)
    put(box, short, *frames(5))
    short.queue_length = 2
    put(box, short, b"newest")
    assert [taken(box, now) for now in (1.0, 2.0, 3.0)] == [[b"frame 0004"], [b"newest"], []]


def test_queued_messages_leave_one_per_throttle_interval_and_say_when():
    box = send_queue()
    put(box, paced(throttle_s=0.1), *frames(3))
    assert taken(box, 5.0) == frames(1)
    assert box.next_due(5.0) == pytest.approx(5.1)
    assert [taken(box, now) for now in (5.05, 5.11, 9.0)] == [[], frames(1, start=1), frames(1, start=2)]
    assert box.next_due(9.0) is None


def test_a_throttled_topic_holds_nothing_else_back_and_is_not_looked_at_meanwhile(free):
    box = send_queue()
    put(box, paced(4.5, queue_length=1000), b"later", *frames(999))
    calls = count_calls(lambda: taken(box, 4.9))
    put(box, free, b"now")
    reply(box, b"reply")
    assert taken(box, 5.0) == [b"now", b"reply"]
    assert calls < 100
    assert box.next_due(5.0) == 5.5
    assert taken(box, 5.5) == [b"later"]


def test_messages_queued_for_a_closed_subscription_are_not_sent():
    box, closed = send_queue(), paced(4.5)
    put(box, closed, *frames(3))
    closed.closed = True
    assert box.next_due(5.0) == 5.0
    assert (taken(box, 5.0), box.next_due(5.0)) == ([], None)


def test_replies_and_requests_up_to_their_bounds_are_kept_and_one_more_overflows_or_is_refused():
    box = send_queue(max_queued_reply_bytes=3 * FRAME_BYTES)
    for _ in range(3):
        reply(box, *frames(3))
        assert not box.overflowed
        assert taken(box, 1.0) == frames(3)
    reply(box, *frames(4))
    assert box.overflowed
    assert taken(box, 1.0) == frames(3)
    box = send_queue(max_queued_request_bytes=2 * encoded(b"1").size_bytes)
    assert [box.put_request(encoded(frame)) for frame in (b"1", b"2", b"3")] == [True, True, False]
    assert taken(box, 1.0) == [b"1", b"2"]
    assert box.put_request(encoded(b"4"))


def test_one_request_and_one_reply_may_have_any_size_and_take_no_room_from_each_other():
    box = send_queue(max_queued_request_bytes=1, max_queued_reply_bytes=1)
    assert box.put_request(encoded(b"x" * 1000))
    reply(box, b"x" * 1000)
    assert not box.overflowed
    reply(box, b"2")
    assert box.overflowed


def test_a_budget_is_kept_to_within_one_message_and_the_rest_leaves_later_in_order(free, other):
    box = send_queue()
    for number, frame in enumerate(frames(6)):
        if number % 3 == 2:
            reply(box, frame)
        else:
            put(box, (free, other)[number % 3], frame)
    assert taken(box, 1.0, 2 * FRAME_BYTES) == frames(2)
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0, 2 * FRAME_BYTES + 1) == frames(3, start=2)
    assert taken(box, 1.0, 1) == frames(1, start=5)
    assert box.next_due(1.0) is None


def test_the_fragments_of_a_message_leave_together_whatever_the_budget_and_are_dropped_together():
    box = send_queue()
    put(box, Subscription("/short", queue_length=1), encoded(b"1", b"2"), encoded(b"3", b"4"))
    reply(box, b"5")
    assert taken(box, 1.0, 1) == [b"3", b"4"]
    assert box.dropped == 1


def test_messages_dropped_by_a_clients_own_throttle_are_counted_apart(free):
    box = send_queue(max_queued_bytes=2 * FRAME_BYTES)
    put(box, paced(-1.0, queue_length=1), *frames(3))
    assert (box.dropped, box.throttled) == (2, 2)
    put(box, free, *frames(3))
    assert box.dropped > box.throttled


# Messages that are encoded later


def test_what_is_behind_a_message_that_is_still_to_be_encoded_waits_for_it():
    box, large = send_queue(), later(b"large")
    box.put_reply(large)
    reply(box, b"small")
    assert [box.take_unready() for _ in range(2)] == [[large], []]
    assert (taken(box, 0.0), box.next_due(0.0)) == ([], None)
    large.encode()
    assert box.next_due(0.0) == 0.0
    assert taken(box, 0.0) == [b"large", b"small"]
    assert (box.empty, box.size_bytes) == (True, 0)


@pytest.mark.parametrize("closed", [False, True])
def test_topic_data_that_waits_alone_leaves_once_it_is_encoded_unless_nobody_wants_it_any_more(closed, free):
    box, large = send_queue(), later(b"large")
    put(box, free, large)
    assert (taken(box, 0.0), box.next_due(0.0)) == ([], None)
    free.closed = closed
    large.encode()
    assert taken(box, 0.0) == ([] if closed else [b"large"])
    assert box.next_due(0.0) is None


def test_a_message_that_could_not_be_encoded_holds_nobody_up():
    def fail():
        raise MessageError("a number", "nothing")

    box, broken = send_queue(), EncodedMessage.later(fail, 100)
    box.put_reply(broken)
    reply(box, b"next")
    with pytest.raises(MessageError):
        broken.encode()
    assert taken(box, 0.0) == [b"next"]


def test_a_message_may_wait_from_the_end_of_its_encoding(free):
    box, large, again = send_queue(), later(b"large"), later(b"again")
    put(box, free, large)
    box.drop_late(DELAY_S + 1.0)
    large.encode()
    box.drop_late(DELAY_S + 1.1)
    assert taken(box, DELAY_S + 1.1) == [b"large"]
    put(box, free, again, now=20.0)
    box.drop_late(21.0 + DELAY_S)
    again.encode()
    box.drop_late(21.1 + 2.0 * DELAY_S)
    assert (taken(box, 21.1 + 2.0 * DELAY_S), box.dropped) == ([], 1)


# Messages that wait for long


def test_a_subscription_that_is_too_far_behind_gets_the_newest(free):
    box = send_queue()
    for number in range(1000):
        put(box, free, b"%d" % number, now=number / 100)
    numbers = [int(frame) for frame in taken(box, 10.0)]
    assert numbers == list(range(1000))[-len(numbers) :]
    assert len(numbers) == pytest.approx(100 * DELAY_S, abs=1)
    assert box.dropped == 1000 - len(numbers)


def test_one_burst_waits_as_long_as_the_client_reads_of_it(free, other):
    box = send_queue()
    put(box, free, *frames(30))
    for number in range(30):
        put(box, other, b"now", now=2.0 * number)
        assert taken(box, 2.0 * number, 1) == frames(1, start=number)
    assert box.dropped > 0


def test_topic_data_is_dropped_of_a_client_that_stands_still_and_replies_stay(free, other):
    box = send_queue()
    put(box, free, *frames(5))
    reply(box, b"reply")
    put(box, other, b"new", now=1.0)
    box.drop_late(DELAY_S + 0.5)
    assert box.dropped == 5
    assert taken(box, DELAY_S + 0.5) == [b"reply", b"new"]


def test_messages_that_wait_for_the_clients_own_throttle_are_not_late():
    box, slow = send_queue(), paced(throttle_s=60.0)
    put(box, slow, *frames(3))
    for now in (10.0, 60.0 + DELAY_S):
        box.drop_late(now)
        put(box, slow, b"next", now=now)
    assert box.dropped == 0
    box.drop_late(60.1 + DELAY_S)
    assert box.dropped == 4
    assert taken(box, 70.0) == [b"next"]


def test_messages_of_a_topic_keep_their_order_when_its_throttle_comes_and_goes():
    box, topic = send_queue(), Subscription("/t", queue_length=10)
    for number, throttle_s in enumerate((0.0, 0.3, 0.0, 0.3)):
        topic.throttle_s = throttle_s
        put(box, topic, b"%d" % number)
    assert [taken(box, now) for now in (1.0, 2.0, 3.0)] == [[b"0"], [b"1"], [b"2"]]
    topic.throttle_s = 0.0
    put(box, topic, b"4", now=3.0)
    assert taken(box, 3.0) == [b"3", b"4"]
    assert box.empty


# Small messages beside large ones

LARGE = b"x" * BULKY_BYTES


def test_small_messages_go_ahead_of_large_ones_of_other_topics_when_the_client_is_behind(free, other):
    box = send_queue()
    put(box, other, *(LARGE + b"%d" % number for number in range(30)))
    now = BEHIND_S + 0.1
    put(box, free, b"joints", now=now)
    reply(box, b"reply")
    got = [frame[-6:] for _ in range(2) for frame in taken(box, now, 65_536)]
    assert {b"joints", b"reply"} < set(got)
    assert len(got) <= 4


def test_all_leave_in_order_of_queuing_while_the_client_keeps_up(free, other):
    box = send_queue()
    put(box, other, LARGE)
    put(box, free, b"joints")
    reply(box, b"reply")
    assert taken(box, BEHIND_S) == [LARGE, b"joints", b"reply"]


def test_pictures_come_through_to_a_client_that_is_behind_with_small_messages_too(free, other):
    box = send_queue()
    put(box, other, *[LARGE] * 3)
    put(box, free, *[b"y" * 30_000] * 100)
    got = [len(frame) for _ in range(8) for frame in taken(box, 1.0, 65_536)]
    assert got.count(len(LARGE)) >= 3
    assert got.count(30_000) >= 6


def test_small_messages_do_not_wait_for_a_large_one_whose_encoding_takes_long(free, other):
    box, large = send_queue(), later(LARGE, size_bytes=BULKY_BYTES)
    put(box, other, large)
    put(box, free, b"joints")
    assert (taken(box, BEHIND_S), box.next_due(BEHIND_S)) == ([], None)
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0) == [b"joints"]
    assert box.next_due(1.0) is None
    large.encode()
    assert box.next_due(1.0) == 1.0
    assert taken(box, 1.0) == [LARGE]
