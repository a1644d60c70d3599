import itertools

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from protocol import send_queue
from protocol.limits import MAX_SERVER_QUEUED_BYTES, Limits
from protocol.publication import FRAME_OVERHEAD_BYTES, EncodedMessage, Frame
from protocol.send_queue import SendBudget, SendQueue
from protocol.subscriptions import Subscription

TOPIC = Subscription("/t")


def encoded(size_bytes: int = 1000) -> EncodedMessage:
    return EncodedMessage(Frame(b"x" * (size_bytes - FRAME_OVERHEAD_BYTES), text=True))


def later(size_bytes: int, estimate_bytes: int = 1000) -> EncodedMessage:
    return EncodedMessage.later(lambda: encoded(size_bytes), estimate_bytes)


def queues(count: int, limit_bytes: int = MAX_SERVER_QUEUED_BYTES) -> tuple[SendBudget, list[SendQueue]]:
    """A budget with a number of clients."""
    budget = SendBudget(limit_bytes)
    return budget, [SendQueue(Limits(), budget) for _ in range(count)]


def put(queue: SendQueue, count: int, size_bytes: int = 1000) -> None:
    for _ in range(count):
        queue.put_topic_data(TOPIC, encoded(size_bytes), 0.0)


def reply(queue: SendQueue, count: int, size_bytes: int = 1000) -> None:
    for _ in range(count):
        queue.put_reply(encoded(size_bytes))


def test_a_client_that_reads_loses_nothing_for_those_that_do_not() -> None:
    _, (reading, *deaf) = queues(10, 100_000)
    for _ in range(100):
        for queue in deaf:
            put(queue, 2)
        put(reading, 30)
        assert sum(len(reading.take_due(0.0, 10_000)) for _ in range(3)) == 30
    assert reading.dropped == 0
    assert all(queue.dropped for queue in deaf)


def test_the_client_that_has_read_least_recently_gives_up_its_oldest_topic_data_also_for_a_newcomer() -> None:
    _, (first, second) = queues(2, 10_000)
    put(first, 5)
    put(second, 5)
    first.take_due(0.0, 1)
    put(first, 3)
    assert (first.dropped, second.dropped) == (0, 2)
    budget, (deaf, late) = queues(2, 10_000)
    put(deaf, 50)
    put(late, 9)
    assert len(late.take_due(0.0, 10**9)) == 9
    assert budget.used_bytes <= 10_000


def test_replies_have_topic_data_of_all_clients_dropped_before_the_client_that_reads_least_is_closed() -> None:
    _, (first, second) = queues(2, 10_000)
    put(first, 5)
    reply(second, 10)
    assert (first.dropped, first.overflowed, second.overflowed) == (5, False, False)
    assert len(second.take_due(0.0, 10**9)) == 10
    _, (deaf, reading) = queues(2, 10_000)
    reply(deaf, 5)
    reply(reading, 5)
    reading.take_due(0.0, 1)
    reply(reading, 2)
    assert (deaf.overflowed, reading.overflowed) == (True, False)
    assert (deaf.size_bytes, reading.size_bytes) == (0, 6000)


def test_a_large_answer_counts_until_the_socket_takes_more() -> None:
    budget, (queue,) = queues(1)
    reply(queue, 1, 1_000_000)
    reply(queue, 1, 2_000_000)
    for left_bytes, empty in ((3_000_000, False), (2_000_000, True)):
        assert len(queue.take_due(0.0, 1)) == 1
        assert queue.empty == empty
        assert budget.used_bytes == queue.size_bytes == left_bytes
    assert queue.take_due(0.0, 1) == []
    assert budget.used_bytes == queue.size_bytes == 0


def test_clients_with_unread_answers_in_their_sockets_are_closed_before_others_are() -> None:
    budget, (*deaf, reading) = queues(4, 3_000_000)
    for queue in deaf:
        reply(queue, 1, 1_000_000)
        queue.take_due(0.0, 1)
    reply(reading, 1, 500_000)
    assert [queue.overflowed for queue in (*deaf, reading)] == [True, False, False, False]
    assert budget.used_bytes == 2_500_000


def test_a_request_for_which_no_room_is_left_is_refused_and_nobody_is_closed() -> None:
    budget, (caller, provider) = queues(2, 10_000)
    reply(caller, 10)
    assert not provider.put_request(encoded())
    assert (provider.empty, caller.overflowed, budget.used_bytes) == (True, False, 10_000)


def test_a_message_counts_by_its_real_size_once_it_has_been_encoded() -> None:
    budget, (queue,) = queues(1)
    queue.put_topic_data(TOPIC, later(50_000), 0.0)
    queue.put_reply(later(7000))
    queue.put_request(later(300 + FRAME_OVERHEAD_BYTES))
    assert budget.used_bytes == 3000
    for each in queue.take_unready():
        each.encode()
    queue.take_unready()
    assert budget.used_bytes == queue.size_bytes == 57_300 + FRAME_OVERHEAD_BYTES
    assert queue.reply_bytes == 7000


def test_what_turns_out_too_large_when_it_is_encoded_has_older_topic_data_dropped() -> None:
    queue = SendQueue(Limits.model_construct(max_queued_bytes=10_000))
    put(queue, 5)
    queue.put_topic_data(TOPIC, later(8000), 0.0)
    (large,) = queue.take_unready()
    large.encode()
    queue.take_unready()
    assert (queue.dropped, queue.size_bytes) == (3, 10_000)


LIMITS = Limits.model_construct(
    max_queued_bytes=20_000,
    max_queued_messages=15,
    max_queued_request_bytes=6000,
    max_queued_reply_bytes=8000,
    max_topic_delay_s=2.0,
)
numbers = st.integers(min_value=0, max_value=3)
sizes = st.integers(min_value=FRAME_OVERHEAD_BYTES, max_value=5000)


class Clients(RuleBasedStateMachine):
    """Clients that come, wait, read and go, in any order; there is always one."""

    def __init__(self) -> None:
        super().__init__()
        # Scaled down like the limits.
        self.patched = pytest.MonkeyPatch()
        self.patched.setattr(send_queue, "LARGE_ANSWER_BYTES", 2000)
        self.patched.setattr(send_queue, "BULKY_BYTES", 3000)
        self.budget = SendBudget(50_000)
        self.clients: list[tuple[SendQueue, list[Subscription]]] = []
        self.encoding: list[EncodedMessage] = []
        # What each message was sent by, and its number; the number of the last that was taken of each.
        self.lanes: dict[EncodedMessage, tuple[object, int]] = {}
        self.last: dict[object, int] = {}
        self.numbers = itertools.count()
        self.now = 0.0
        self.come()

    @property
    def queues(self) -> list[SendQueue]:
        return [queue for queue, _ in self.clients]

    def pick(self, number: int) -> tuple[SendQueue, list[Subscription]]:
        return self.clients[number % len(self.clients)]

    @rule()
    def come(self) -> None:
        paced = Subscription("/c", throttle_s=0.5, queue_length=5)
        subscriptions = [Subscription("/a"), Subscription("/b", queue_length=3), paced]
        self.clients.append((SendQueue(LIMITS, self.budget), subscriptions))

    @rule(number=numbers)
    def go(self, number: int) -> None:
        queue, _ = self.clients.pop(number % len(self.clients))
        queue.close()
        if not self.clients:
            self.come()

    @rule(number=numbers, kind=st.sampled_from(["reply", "request", 0, 1, 2]), size_bytes=sizes, at_once=st.booleans())
    def send(self, number: int, kind: str | int, size_bytes: int, at_once: bool) -> None:
        queue, subscriptions = self.pick(number)
        message = encoded(size_bytes) if at_once else later(size_bytes)
        self.lanes[message] = subscriptions[kind] if isinstance(kind, int) else queue, next(self.numbers)
        if isinstance(kind, int):
            queue.put_topic_data(subscriptions[kind], message, self.now)
        else:
            (queue.put_reply if kind == "reply" else queue.put_request)(message)

    @rule(number=numbers, size_bytes=sizes)
    def read(self, number: int, size_bytes: int) -> None:
        taken = [self.lanes.pop(message) for message in self.pick(number)[0].take_due(self.now, size_bytes)]
        for lane, place in taken:
            assert place > self.last.get(lane, -1)
            self.last[lane] = place

    @rule(number=numbers, which=numbers, end=st.booleans())
    def change_or_end_a_subscription(self, number: int, which: int, end: bool) -> None:
        _, subscriptions = self.pick(number)
        subscription = subscriptions[which % 3]
        if end:
            subscription.closed = True
            subscriptions[which % 3] = Subscription("/d")
        else:
            subscription.throttle_s, subscription.queue_length = 0.5 - subscription.throttle_s, 4

    @rule(number=numbers)
    def stand_still(self, number: int) -> None:
        self.pick(number)[0].drop_late(self.now)

    @rule()
    def begin_encoding(self) -> None:
        self.encoding += [each for queue in self.queues for each in queue.take_unready()]

    @rule()
    def end_encoding(self) -> None:
        for each in self.encoding:
            each.encode()
        self.encoding.clear()
        self.begin_encoding()

    @rule()
    def let_time_pass(self) -> None:
        self.now += 0.4

    @invariant()
    def the_budget_is_the_sum_of_what_waits_and_knows_exactly_those_for_whom_something_does(self) -> None:
        assert self.budget.used_bytes == sum(queue.size_bytes for queue in self.queues)
        assert set(self.budget._holders) == {queue for queue in self.queues if queue.size_bytes}

    @invariant()
    def no_bound_is_exceeded_by_more_than_one_message_and_an_empty_queue_has_no_bytes(self) -> None:
        assert self.budget.used_bytes <= self.budget.limit_bytes
        for queue in self.queues:
            assert queue._bytes["topic data"] <= LIMITS.max_queued_bytes
            assert min(queue._bytes.values()) >= 0
            assert not queue.empty or queue.size_bytes == queue._leaving_bytes

    @invariant()
    def each_subscription_knows_exactly_what_waits_for_it(self) -> None:
        for queue in self.queues:
            known = [[each.sequence for each in lane] for lane in queue._waiting.values()]
            assert sorted(itertools.chain(*known)) == sorted((*queue._free, *queue._bulky, *queue._paced))
            assert all(lane == sorted(lane) for lane in known)

    def teardown(self) -> None:
        self.patched.undo()
        for queue in self.queues:
            queue.close()
        assert self.budget.used_bytes == 0
        assert not self.budget._holders


TestClients = Clients.TestCase


def test_the_parts_of_the_send_budget_fit_together() -> None:
    limits = Limits()
    assert limits.max_queued_bytes <= MAX_SERVER_QUEUED_BYTES / 4
    assert limits.max_queued_request_bytes + limits.max_queued_reply_bytes < limits.max_queued_bytes
