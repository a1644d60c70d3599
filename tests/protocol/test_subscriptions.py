from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import NothingToDoError, OperationError
from protocol.operations import Advertise, Subscribe, qualify
from protocol.subscriptions import Publications, Registrations, Subscription, Subscriptions


@pytest.fixture
def table():
    return Registrations("advertise", "unadvertise", limit=3)


def test_the_first_entry_on_a_topic_is_told_from_later_ones(table):
    assert table.put("/a", 1, "x") is True
    assert table.put("/a", 2, "y") is False
    assert list(table.entries("/a")) == ["x", "y"]


def test_a_topic_has_one_key_for_all_its_spellings(table):
    table.put("a", None, "x")
    assert list(table) == ["/a"]
    assert "a" in table
    assert "/a" in table
    assert table.remove("/a", None) is True


def test_an_id_that_is_known_withdraws_that_entry_alone(table):
    table.put("/a", 1, "x")
    table.put("/a", 2, "y")
    assert table.remove("/a", 1) is False
    assert list(table.entries("/a")) == ["y"]
    assert table.remove("/a", 2) is True
    assert "/a" not in table


def test_an_unknown_id_withdraws_nothing_and_says_so(table):
    table.put("/a", 1, "x")
    with pytest.raises(NothingToDoError, match="unadvertise: topic /a under id 9: this client has no advertise"):
        table.remove("/a", 9)
    assert list(table.entries("/a")) == ["x"]


@pytest.mark.parametrize("mark", [None, 1])
def test_an_unknown_topic_is_left_alone(table, mark):
    with pytest.raises(NothingToDoError, match="unadvertise: topic /a"):
        table.remove("/a", mark)


def test_one_entry_too_many_is_refused_and_changes_nothing(table):
    for mark in (1, 2, 3):
        table.put("/a", mark, "x")
    with pytest.raises(OperationError, match="advertise: this client has 3, the limit is 3"):
        table.put("/b", 1, "x")
    assert list(table) == ["/a"]


def test_topics_can_be_withdrawn_while_going_over_them(table):
    table.put("/a", 1, "x")
    table.put("/b", 1, "x")
    for topic in table:
        table.remove(topic, None)
    assert list(table) == []


actions = st.tuples(st.booleans(), st.sampled_from(["a", "/a", "/b"]), st.sampled_from([None, 1, "1"]))


@given(st.lists(actions, max_size=30))
def test_the_limit_counts_what_is_there(steps):
    table, limit = Registrations("subscribe", "unsubscribe", limit=3), 3
    model = set()
    for put, topic, mark in steps:
        key = (qualify(topic), mark)
        if put and (key in model or len(model) < limit):
            table.put(topic, mark, "x")
            model.add(key)
        elif put:
            with pytest.raises(OperationError):
                table.put(topic, mark, "x")
        elif any(topic_there == key[0] and mark in (None, there) for topic_there, there in model):
            table.remove(topic, mark)
            model = {k for k in model if k[0] != key[0] or (mark is not None and k[1] != mark)}
        else:
            with pytest.raises(NothingToDoError):
                table.remove(topic, mark)
        assert set(table) == {topic for topic, _ in model}


def test_publications_register_what_is_advertised():
    publications = Publications(limit=1)
    assert publications.add(Advertise(topic="a", type="std_msgs/String")) is True
    assert publications.add(Advertise(topic="/a", type="std_msgs/String")) is False
    with pytest.raises(OperationError, match=r"^advertise: "):
        publications.add(Advertise(topic="/b", type="std_msgs/String"))
    assert publications.remove("/a", None) is True


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


def test_several_ids_on_one_topic_are_one_delivery():
    table = subscriptions(subscribe(id="x"))
    first = table.get("/a")
    assert table.add(subscribe(id="y")) is False
    assert table.get("/a") is first
    assert list(table) == ["/a"]


def test_throttle_and_queue_of_several_ids_are_the_least_of_each():
    both = (subscribe(id=1, throttle_rate=200, queue_length=5), subscribe(id=2, throttle_rate=100, queue_length=9))
    assert merged(*both) == merged(*reversed(both)) == (0.1, 5)


def test_subscribing_again_with_the_same_id_replaces():
    assert merged(subscribe(id=1, throttle_rate=100), subscribe(id=1, throttle_rate=300)) == (0.3, 0)
    assert merged(subscribe(throttle_rate=100), subscribe(throttle_rate=300)) == (0.3, 0)


def test_unsubscribing_one_id_merges_the_rest_anew():
    table = subscriptions(subscribe(id=1, throttle_rate=100), subscribe(id=2, throttle_rate=300))
    assert table.remove("/a", 1) is False
    assert table.get("/a").throttle_s == 0.3


def test_unsubscribing_without_an_id_withdraws_all_and_closes_the_delivery():
    table = subscriptions(subscribe(id=1), subscribe(id=2))
    subscription = table.get("/a")
    assert table.remove("/a", None) is True
    assert subscription.closed
    assert table.get("/a") is None
    assert "/a" not in table


def test_a_topic_is_delivered_as_its_first_subscription_spelled_it():
    table = subscriptions(subscribe("a", id=1), subscribe("/a", id=2))
    assert table.get("/a").spelled_topic == "a"


def test_a_topic_subscribed_to_anew_is_delivered_in_its_new_spelling():
    table = subscriptions(subscribe("a"))
    table.remove("a", None)
    assert table.add(subscribe("/a")) is True
    assert table.get("/a").spelled_topic == "/a"


def test_the_compression_that_any_id_wants_most_serves_all():
    for compressions, chosen in [
        (("none", "png"), "png"),
        (("png", "cbor", "none"), "cbor"),
        (("cbor", "cbor-raw"), "cbor-raw"),
    ]:
        table = subscriptions(*(subscribe(id=one, compression=one) for one in compressions))
        assert table.get("/a").compression == chosen


def test_the_least_fragment_size_that_is_given_serves_all():
    table = subscriptions(subscribe(id=1), subscribe(id=2, fragment_size=500), subscribe(id=3, fragment_size=200))
    assert table.get("/a").fragment_size == 200
    table.remove("/a", 3)
    table.remove("/a", 2)
    assert table.get("/a").fragment_size is None


# The rules


def test_without_a_throttle_every_message_is_admitted_and_due_at_once():
    subscription = Subscription("/a")
    assert all(subscription.admit(0.0) for _ in range(3))
    assert subscription.due_count(3, 0.0) == 3
    assert subscription.due_s == -float("inf")


def test_without_a_queue_a_message_that_comes_too_early_is_not_admitted():
    subscription = Subscription("/a", throttle_s=0.1)
    assert [subscription.admit(now) for now in (5.0, 5.05, 5.11, 5.2, 5.22)] == [True, False, True, False, True]


def test_with_a_queue_all_are_admitted_and_one_leaves_per_interval():
    subscription = Subscription("/a", throttle_s=0.1, queue_length=4)
    assert all(subscription.admit(5.0) for _ in range(4))
    assert subscription.due_count(4, 5.0) == 1
    subscription.sent(5.0)
    assert subscription.due_count(3, 5.05) == 0
    assert subscription.due_s == pytest.approx(5.1)
    assert subscription.due_count(3, subscription.due_s) == 1


def test_messages_queued_for_a_closed_subscription_are_due_at_once():
    subscription = Subscription("/a", throttle_s=10.0, queue_length=4, last_sent_s=5.0, closed=True)
    assert subscription.due_count(3, 5.0) == 3


@pytest.mark.parametrize(("throttle_s", "queue_length", "skips"), [(0.1, 0, True), (0.1, 1, False), (0.0, 0, False)])
def test_only_a_throttle_without_a_queue_skips_messages(throttle_s, queue_length, skips):
    assert Subscription("/a", throttle_s, queue_length).skips is skips


@given(
    st.floats(min_value=0.001, max_value=10.0),
    st.lists(st.floats(min_value=0.0, max_value=1.0), max_size=50),
)
def test_admitted_messages_are_never_closer_than_the_throttle(throttle_s, gaps_s):
    subscription = Subscription("/a", throttle_s=throttle_s)
    now, admitted = 100.0, []
    for gap_s in gaps_s:
        now += gap_s
        if subscription.admit(now):
            admitted.append(now)
    assert all(later >= earlier + throttle_s for earlier, later in itertools.pairwise(admitted))
