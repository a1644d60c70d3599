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
        assert set(table._entries) == {topic for topic, _ in model}


def merged(*asked):
    """The table with a subscription for each of some wishes, under ids from 1 on."""
    table = Subscriptions(100)
    for number, fields in enumerate(asked, 1):
        table.add(Subscribe(topic="/a", id=number, **fields))
    return table


def test_the_least_throttle_queue_and_fragment_size_of_several_ids_serve_all():
    both = {"throttle_rate": 200, "queue_length": 5}, {"throttle_rate": 100, "queue_length": 9}
    for asked in (both, both[::-1]):
        subscription = merged(*asked).get("/a")
        assert (subscription.throttle_s, subscription.queue_length) == (0.1, 5)
    table = merged({}, {"fragment_size": 500}, {"fragment_size": 200})
    assert table.get("/a").fragment_size == 200
    table.remove("/a", 3)
    table.remove("/a", 2)
    assert table.get("/a").fragment_size is None


@given(st.floats(min_value=0.001, max_value=10.0), st.lists(st.floats(min_value=0.0, max_value=1.0), max_size=50))
def test_admitted_messages_are_never_closer_than_the_throttle(throttle_s, gaps_s):
    subscription = Subscription("/a", throttle_s=throttle_s)
    admitted = [now for now in itertools.accumulate(gaps_s, initial=100.0) if subscription.admit(now)]
    assert all(later >= earlier + throttle_s for earlier, later in itertools.pairwise(admitted))
