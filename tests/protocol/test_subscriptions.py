import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import NothingToDoError, OperationError
from protocol.operations import Advertise, Subscribe, qualify
from protocol.subscriptions import Registrations, Subscription, Subscriptions

actions = st.tuples(st.booleans(), st.sampled_from(["a", "/a", "/b"]), st.sampled_from([None, 1, "1"]))


@given(st.lists(actions, max_size=30))
def test_the_limit_counts_what_is_there(steps):
    table, limit = Registrations("subscribe", "unsubscribe", limit=3), 3
    model = set()
    for put, topic, mark in steps:
        key = (qualify(topic), mark)
        if put and (key in model or len(model) < limit):
            table.add(Advertise(topic=topic, type="t", id=mark))
            model.add(key)
        elif put:
            with pytest.raises(OperationError):
                table.add(Advertise(topic=topic, type="t", id=mark))
        elif any(topic_there == key[0] and mark in (None, there) for topic_there, there in model):
            table.remove(topic, mark)
            model = {k for k in model if k[0] != key[0] or (mark is not None and k[1] != mark)}
        else:
            with pytest.raises(NothingToDoError):
                table.remove(topic, mark)
        assert set(table) == {topic for topic, _ in model}


def subscriptions(*operations, limit=100):
    table = Subscriptions(limit)
    for operation in operations:
        table.add(operation)
    return table


def subscribe(topic="/a", **fields):
    return Subscribe(topic=topic, **fields)


def merged(*operations):
    subscription = subscriptions(*operations).get("/a")
    return subscription.throttle_s, subscription.queue_length


# The table


def test_throttle_and_queue_of_several_ids_are_the_least_of_each():
    both = (subscribe(id=1, throttle_rate=200, queue_length=5), subscribe(id=2, throttle_rate=100, queue_length=9))
    assert merged(*both) == merged(*reversed(both)) == (0.1, 5)


def test_the_least_fragment_size_that_is_given_serves_all():
    table = subscriptions(subscribe(id=1), subscribe(id=2, fragment_size=500), subscribe(id=3, fragment_size=200))
    assert table.get("/a").fragment_size == 200
    table.remove("/a", 3)
    table.remove("/a", 2)
    assert table.get("/a").fragment_size is None


# The rules


def test_messages_queued_for_a_closed_subscription_are_due_at_once():
    subscription = Subscription("/a", throttle_s=10.0, queue_length=4, last_sent_s=5.0, closed=True)
    assert subscription.due_count(3, 5.0) == 3


@given(st.floats(min_value=0.001, max_value=10.0), st.lists(st.floats(min_value=0.0, max_value=1.0), max_size=50))
def test_admitted_messages_are_never_closer_than_the_throttle(throttle_s, gaps_s):
    subscription = Subscription("/a", throttle_s=throttle_s)
    now, admitted = 100.0, []
    for gap_s in gaps_s:
        now += gap_s
        if subscription.admit(now):
            admitted.append(now)
    assert all(later >= earlier + throttle_s for earlier, later in itertools.pairwise(admitted))
