import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

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


def queues(budget: SendBudget, count: int) -> list[SendQueue]:
    return [SendQueue(Limits(), budget) for _ in range(count)]


def put(queue: SendQueue, count: int, size_bytes: int = 1000) -> None:
    for _ in range(count):
        queue.put_topic_data(TOPIC, encoded(size_bytes), 0.0)


def test_a_client_that_reads_loses_nothing_for_those_that_do_not() -> None:
    budget = SendBudget(100_000)
    reading, *deaf = queues(budget, 10)
    for _ in range(100):
        for queue in deaf:
            put(queue, 2)
        put(reading, 30)
        assert sum(len(reading.take_due(0.0, 10_000)) for _ in range(3)) == 30
    assert reading.dropped == 0
    assert all(queue.dropped for queue in deaf)


def test_the_client_that_has_read_least_recently_gives_up_its_oldest_topic_data() -> None:
    budget = SendBudget(10_000)
    first, second = queues(budget, 2)
    put(first, 5)
    put(second, 5)
    first.take_due(0.0, 1)
    put(first, 3)
    assert (first.dropped, second.dropped) == (0, 2)


def test_one_that_stands_still_does_not_keep_a_newcomer_from_having_its_message() -> None:
    budget = SendBudget(10_000)
    deaf, late = queues(budget, 2)
    put(deaf, 50)
    put(late, 9)
    assert len(late.take_due(0.0, 10**9)) == 9
    assert budget.used_bytes <= 10_000


def test_replies_have_topic_data_of_all_clients_dropped_before_anybody_is_closed() -> None:
    budget = SendBudget(10_000)
    first, second = queues(budget, 2)
    put(first, 5)
    for _ in range(10):
        second.put_reply(encoded())
    assert first.dropped == 5
    assert not first.overflowed
    assert not second.overflowed
    assert len(second.take_due(0.0, 10**9)) == 10


def test_where_only_replies_are_left_the_client_that_reads_least_is_closed() -> None:
    budget = SendBudget(10_000)
    deaf, reading = queues(budget, 2)
    for queue in (deaf, reading):
        for _ in range(5):
            queue.put_reply(encoded())
    reading.take_due(0.0, 1)
    for _ in range(2):
        reading.put_reply(encoded())
    assert deaf.overflowed
    assert not reading.overflowed
    assert (deaf.size_bytes, reading.size_bytes) == (0, 6000)


def test_a_large_answer_counts_until_the_socket_takes_more() -> None:
    budget = SendBudget()
    (queue,) = queues(budget, 1)
    queue.put_reply(encoded(1_000_000))
    queue.put_reply(encoded(2_000_000))
    assert len(queue.take_due(0.0, 1)) == 1
    assert budget.used_bytes == queue.size_bytes == 3_000_000
    assert len(queue.take_due(0.0, 1)) == 1
    assert queue.empty
    assert budget.used_bytes == queue.size_bytes == 2_000_000
    assert queue.take_due(0.0, 1) == []
    assert budget.used_bytes == queue.size_bytes == 0


def test_clients_with_unread_answers_in_their_sockets_are_closed_before_others_are() -> None:
    budget = SendBudget(3_000_000)
    *deaf, reading = queues(budget, 4)
    for queue in deaf:
        queue.put_reply(encoded(1_000_000))
        queue.take_due(0.0, 1)
    reading.put_reply(encoded(500_000))
    assert [queue.overflowed for queue in deaf] == [True, False, False]
    assert not reading.overflowed
    assert budget.used_bytes == 2_500_000


def test_a_request_for_which_no_room_is_left_is_refused_and_nobody_is_closed() -> None:
    budget = SendBudget(10_000)
    caller, provider = queues(budget, 2)
    for _ in range(10):
        caller.put_reply(encoded())
    assert not provider.put_request(encoded())
    assert provider.empty
    assert not caller.overflowed
    assert budget.used_bytes == 10_000


def test_a_message_counts_by_its_real_size_once_it_has_been_encoded() -> None:
    budget = SendBudget()
    (queue,) = queues(budget, 1)
    large = later(50_000)
    queue.put_topic_data(TOPIC, large, 0.0)
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
    assert queue.dropped == 3
    assert queue.size_bytes == 10_000


LIMITS = Limits.model_construct(
    max_queued_bytes=20_000,
    max_queued_messages=15,
    max_queued_request_bytes=6000,
    max_queued_reply_bytes=8000,
    max_topic_delay_s=2.0,
)
LARGEST_BYTES = 5000

numbers = st.integers(min_value=0, max_value=3)
sizes = st.integers(min_value=FRAME_OVERHEAD_BYTES, max_value=LARGEST_BYTES)


class Clients(RuleBasedStateMachine):
    """Clients that come, wait, read and go, in any order."""

    def __init__(self) -> None:
        super().__init__()
        # Scaled down like the limits.
        self.patched = pytest.MonkeyPatch()
        self.patched.setattr(send_queue, "LARGE_ANSWER_BYTES", 2000)
        self.patched.setattr(send_queue, "BULKY_BYTES", 3000)
        self.budget = SendBudget(50_000)
        self.queues: list[SendQueue] = []
        self.subscriptions: list[list[Subscription]] = []
        self.encoding: list[EncodedMessage] = []
        self.now = 0.0

    def pick(self, number: int) -> SendQueue:
        return self.queues[number % len(self.queues)]

    @rule()
    def come(self) -> None:
        self.queues.append(SendQueue(LIMITS, self.budget))
        paced = Subscription("/c", throttle_s=0.5, queue_length=5)
        self.subscriptions.append([Subscription("/a"), Subscription("/b", queue_length=3), paced])

    @precondition(lambda self: self.queues)
    @rule(number=numbers)
    def go(self, number: int) -> None:
        queue = self.pick(number)
        queue.close()
        del self.subscriptions[self.queues.index(queue)]
        self.queues.remove(queue)

    @precondition(lambda self: self.queues)
    @rule(number=numbers, which=numbers, size_bytes=sizes, at_once=st.booleans())
    def publish(self, number: int, which: int, size_bytes: int, at_once: bool) -> None:
        message = encoded(size_bytes) if at_once else later(size_bytes)
        queue = self.pick(number)
        queue.put_topic_data(self.subscriptions[self.queues.index(queue)][which % 3], message, self.now)

    @precondition(lambda self: self.queues)
    @rule(number=numbers, size_bytes=sizes, at_once=st.booleans())
    def reply(self, number: int, size_bytes: int, at_once: bool) -> None:
        self.pick(number).put_reply(encoded(size_bytes) if at_once else later(size_bytes))

    @precondition(lambda self: self.queues)
    @rule(number=numbers, size_bytes=sizes, at_once=st.booleans())
    def ask(self, number: int, size_bytes: int, at_once: bool) -> None:
        self.pick(number).put_request(encoded(size_bytes) if at_once else later(size_bytes))

    @precondition(lambda self: self.queues)
    @rule(number=numbers, size_bytes=sizes)
    def read(self, number: int, size_bytes: int) -> None:
        self.pick(number).take_due(self.now, size_bytes)

    @precondition(lambda self: self.queues)
    @rule(number=numbers, which=numbers)
    def change_rule(self, number: int, which: int) -> None:
        subscription = self.subscriptions[self.queues.index(self.pick(number))][which % 3]
        subscription.throttle_s, subscription.queue_length = 0.5 - subscription.throttle_s, 4

    @precondition(lambda self: self.queues)
    @rule(number=numbers, which=numbers)
    def unsubscribe(self, number: int, which: int) -> None:
        subscriptions = self.subscriptions[self.queues.index(self.pick(number))]
        subscriptions[which % 3].closed = True
        subscriptions[which % 3] = Subscription("/d")

    @precondition(lambda self: self.queues)
    @rule(number=numbers)
    def stand_still(self, number: int) -> None:
        self.pick(number).drop_late(self.now)

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
    def the_budget_is_the_sum_of_what_waits(self) -> None:
        assert self.budget.used_bytes == sum(queue.size_bytes for queue in self.queues)

    @invariant()
    def the_budget_knows_exactly_those_for_whom_something_waits(self) -> None:
        assert set(self.budget._holders) == {queue for queue in self.queues if queue.size_bytes}

    @invariant()
    def no_bound_is_exceeded_by_more_than_one_message(self) -> None:
        assert self.budget.used_bytes <= self.budget.limit_bytes
        assert all(queue._topic_bytes <= LIMITS.max_queued_bytes for queue in self.queues)
        assert all(queue._request_bytes >= 0 and queue.reply_bytes >= 0 for queue in self.queues)

    @invariant()
    def each_subscription_knows_exactly_what_waits_for_it(self) -> None:
        for queue in self.queues:
            known = sorted(sequence for lane in queue._waiting.values() for sequence in lane)
            assert known == sorted((*queue._free, *queue._bulky, *queue._paced))
            assert all(list(lane) == sorted(lane) for lane in queue._waiting.values())

    @invariant()
    def an_empty_queue_has_no_bytes(self) -> None:
        assert all(queue.size_bytes == queue._leaving_bytes for queue in self.queues if queue.empty)

    def teardown(self) -> None:
        self.patched.undo()
        for queue in self.queues:
            queue.close()
        assert self.budget.used_bytes == 0
        assert not self.budget._holders


TestClients = Clients.TestCase


@given(st.lists(sizes, max_size=100))
def test_all_that_is_put_leaves_or_is_dropped_when_time_is_up(sizes_bytes: list[int]) -> None:
    budget = SendBudget(30_000)
    (queue,) = queues(budget, 1)
    for size_bytes in sizes_bytes:
        put(queue, 1, size_bytes)
    queue.drop_late(Limits().max_topic_delay_s + 0.1)
    assert budget.used_bytes == 0
    assert queue.dropped == len(sizes_bytes)


def test_the_parts_of_the_send_budget_fit_together() -> None:
    assert Limits().max_queued_bytes <= MAX_SERVER_QUEUED_BYTES / 4
    limits = Limits()
    assert limits.max_queued_request_bytes + limits.max_queued_reply_bytes < limits.max_queued_bytes
