from __future__ import annotations

from typing import Any

import pytest

from protocol.errors import MessageError
from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from server.errors import GraphError
from server.graph import topics
from server.graph.node import Node
from server.graph.topics import (
    MAX_RECENT_PER_TOPIC,
    MAX_TOPICS,
    UNREGISTER_TIMEOUT_S,
    Graph,
    LatchedMessages,
    Subscriber,
)

REGISTRY = Registry.load()


def published(data: str, topic: str = "/t") -> PublishedMessage:
    return PublishedMessage(topic, "std_msgs/msg/String", {"data": data}, REGISTRY, Stamp(1, 2))


def data_of(kept: LatchedMessages, now: float, topic: str = "/t") -> list[str]:
    return [one.msg["data"] for one in kept.of(topic, now)]


@pytest.fixture
def kept() -> LatchedMessages:
    return LatchedMessages()


def test_the_last_latched_message_is_kept_for_ever(kept: LatchedMessages) -> None:
    assert kept.latch(published("old"))
    assert kept.latch(published("new"))
    assert data_of(kept, 1e9) == ["new"]


def test_a_latched_message_can_be_given_an_end(kept: LatchedMessages) -> None:
    kept.latch(published("x"))
    kept.unlatch_at("/t", 10.0)
    assert data_of(kept, 9.9) == ["x"]
    assert data_of(kept, 10.1) == []


def test_latching_anew_takes_the_end_away(kept: LatchedMessages) -> None:
    kept.latch(published("x"))
    kept.unlatch_at("/t", 10.0)
    kept.latch(published("y"))
    assert data_of(kept, 100.0) == ["y"]


def test_messages_are_kept_for_their_lifespan_in_order(kept: LatchedMessages) -> None:
    for now, data in enumerate("abc"):
        kept.keep(published(data), float(now), lifespan_s=1.5)
    assert data_of(kept, 2.2) == ["b", "c"]
    assert data_of(kept, 4.0) == []


def test_topics_do_not_mix(kept: LatchedMessages) -> None:
    kept.keep(published("a"), 0.0, 1.0)
    kept.latch(published("b", "/other"))
    assert data_of(kept, 0.5) == ["a"]
    assert data_of(kept, 0.5, "/other") == ["b"]
    kept.forget("/t")
    assert data_of(kept, 0.5) == []
    assert data_of(kept, 0.5, "/other") == ["b"]


def test_of_one_topic_only_so_many_are_kept(kept: LatchedMessages) -> None:
    for number in range(3 * MAX_RECENT_PER_TOPIC):
        kept.keep(published(str(number)), 0.0, 1.0)
    assert data_of(kept, 0.5) == [str(number) for number in range(2 * MAX_RECENT_PER_TOPIC, 3 * MAX_RECENT_PER_TOPIC)]


def test_recent_messages_are_bounded_in_bytes_and_the_oldest_goes(
    kept: LatchedMessages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topics, "MAX_RECENT_BYTES", 1000)
    for number in range(20):
        kept.keep(published(f"{number:0200}", f"/t{number}"), 0.0, 1.0)
    assert [number for number in range(20) if kept.of(f"/t{number}", 0.5)] == [16, 17, 18, 19]


def test_a_message_larger_than_the_bound_is_not_kept(kept: LatchedMessages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topics, "MAX_RECENT_BYTES", 1000)
    kept.keep(published("x" * 2000), 0.0, 1.0)
    assert data_of(kept, 0.5) == []
    kept.keep(published("x"), 0.0, 1.0)
    assert data_of(kept, 0.5) == ["x"]


def test_latched_messages_are_bounded_in_bytes_together(kept: LatchedMessages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topics, "MAX_LATCHED_BYTES", 1000)
    assert kept.latch(published("x" * 600, "/a"))
    assert not kept.latch(published("x" * 600, "/b"))
    kept.unlatch("/a")
    assert kept.latch(published("x" * 600, "/b"))
    assert data_of(kept, 0.0, "/a") == []


class Listening:
    """A node that keeps what it gets."""

    def __init__(self) -> None:
        self.node = Node("listener")
        self.messages: list[Any] = []
        self.refusals: list[MessageError] = []
        self.subscriber = Subscriber(self._deliver, self.refusals.append)

    def _deliver(self, published: PublishedMessage) -> None:
        self.messages.append(published.msg)


class Clock:
    """Monotonic time that a test moves."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def graph(clock: Clock) -> Graph:
    return Graph(REGISTRY, clock, wall_clock=lambda: 12.5)


TALKER = Node("talker")


def test_a_message_reaches_every_subscriber_complete(graph: Graph) -> None:
    first, second = Listening(), Listening()
    for listener in (first, second):
        graph.subscribe(listener.node, "/t", "geometry_msgs/Point", listener.subscriber)
    graph.publish(TALKER, "/t", {"x": 1})
    assert first.messages == second.messages == [{"x": 1.0, "y": 0.0, "z": 0.0}]


def test_a_publisher_that_subscribes_hears_itself(graph: Graph) -> None:
    listener = Listening()
    graph.advertise(listener.node, "/t", "std_msgs/String")
    graph.subscribe(listener.node, "/t", None, listener.subscriber)
    graph.publish(listener.node, "/t", {"data": "me"})
    assert listener.messages == [{"data": "me"}]


def test_an_omitted_header_gets_the_time_of_receipt(graph: Graph) -> None:
    listener = Listening()
    graph.subscribe(listener.node, "/t", "sensor_msgs/JointState", listener.subscriber)
    graph.publish(TALKER, "/t", {})
    assert listener.messages[0]["header"]["stamp"] == {"sec": 12, "nanosec": 500_000_000}


def test_the_first_type_of_a_topic_stays(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    listener = Listening()
    with pytest.raises(GraphError, match=r"/t.*std_msgs/msg/String.*std_msgs/Bool"):
        graph.subscribe(listener.node, "/t", "std_msgs/Bool", listener.subscriber)
    graph.publish(TALKER, "/t", {"data": "x"})
    assert listener.messages == []
    assert graph.topic_types() == {"/t": "std_msgs/msg/String"}


def test_both_spellings_of_a_type_are_the_same_type(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    graph.advertise(Node("other"), "/t", "std_msgs/msg/String")


def test_a_type_that_nobody_knows_is_refused(graph: Graph) -> None:
    with pytest.raises(GraphError, match="std_msgs/Strang"):
        graph.advertise(TALKER, "/t", "std_msgs/Strang")
    assert graph.topic_types() == {}


def test_publishing_on_a_topic_without_a_type_is_refused(graph: Graph) -> None:
    with pytest.raises(GraphError, match="no type yet"):
        graph.publish(TALKER, "/t", {})


def test_a_message_that_does_not_fit_is_refused_to_its_sender_and_told_to_local_subscribers(graph: Graph) -> None:
    listener = Listening()
    graph.subscribe(listener.node, "/t", "std_msgs/String", listener.subscriber)
    with pytest.raises(MessageError, match="data"):
        graph.publish(TALKER, "/t", {"data": 5})
    assert listener.messages == []
    assert [error.path for error in listener.refusals] == ["data"]


def test_a_latched_message_is_kept_for_late_subscribers(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "old"})
    graph.publish(TALKER, "/t", {"data": "new"})
    listener = Listening()
    kept = graph.subscribe(listener.node, "/t", None, listener.subscriber)
    assert [published.msg for published in kept] == [{"data": "new"}]


def test_it_can_be_told_whether_a_topic_is_latched(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    assert not graph.is_latched("/t")
    graph.publish(TALKER, "/t", {"data": "kept"}, latch=True)
    assert graph.is_latched("/t")
    assert not graph.is_latched("/nothing")


def test_a_message_that_is_only_latched_reaches_late_subscribers_alone(graph: Graph) -> None:
    early, late = Listening(), Listening()
    graph.advertise(TALKER, "/t", "std_msgs/String")
    graph.subscribe(early.node, "/t", None, early.subscriber)
    graph.latch("/t", {"data": "everything"})
    graph.publish(TALKER, "/t", {"data": "a change"})
    assert early.messages == [{"data": "a change"}]
    kept = graph.subscribe(late.node, "/t", None, late.subscriber)
    assert [published.msg for published in kept] == [{"data": "everything"}]


def test_a_latched_message_is_not_revived_by_another_publisher_that_leaves(graph: Graph, clock: Clock) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "old"})
    listener, other = Listening(), Node("other")
    graph.subscribe(listener.node, "/t", None, listener.subscriber)
    graph.remove(TALKER)
    clock.now_s += UNREGISTER_TIMEOUT_S * 0.9
    graph.advertise(other, "/t", "std_msgs/String")
    graph.unadvertise(other, "/t")
    clock.now_s += UNREGISTER_TIMEOUT_S * 0.9
    assert graph.subscribe(Node("late"), "/t", None, listener.subscriber) == []


def test_a_node_that_left_gets_nothing_and_its_topics_are_forgotten(graph: Graph) -> None:
    listener = Listening()
    graph.advertise(TALKER, "/a", "std_msgs/String")
    graph.subscribe(listener.node, "/a", None, listener.subscriber)
    graph.subscribe(listener.node, "/b", "std_msgs/String", listener.subscriber)
    graph.remove(listener.node)
    graph.publish(TALKER, "/a", {"data": "x"})
    assert listener.messages == []
    assert list(graph.topic_types()) == ["/a"]
    graph.unadvertise(TALKER, "/a")
    assert graph.topic_types() == {}


def test_the_type_of_a_topic_outlives_its_last_user_for_a_while(graph: Graph, clock: Clock) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    graph.remove(TALKER)
    clock.now_s += UNREGISTER_TIMEOUT_S * 0.9
    graph.publish(TALKER, "/t", {"data": "known still"})
    graph.remove(TALKER)
    graph.remove(Node("someone else"))
    clock.now_s += UNREGISTER_TIMEOUT_S * 1.1
    with pytest.raises(GraphError, match="no type yet"):
        graph.publish(TALKER, "/t", {"data": "forgotten"})
    graph.advertise(TALKER, "/t", "std_msgs/Bool")


def test_for_how_long_can_be_set(clock: Clock) -> None:
    graph = Graph(REGISTRY, clock, unregister_timeout_s=1.0)
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "old"})
    graph.advertise(TALKER, "/other", "std_msgs/String")
    graph.advertise(Node("other"), "/t", "std_msgs/String")
    graph.remove(TALKER)
    listener = Listening()
    clock.now_s += 0.9
    assert graph.topic_type("/other") is not None
    assert len(graph.subscribe(listener.node, "/t", None, listener.subscriber)) == 1
    clock.now_s += 0.2
    assert graph.topic_type("/other") is None
    assert graph.subscribe(Node("late"), "/t", None, listener.subscriber) == []


def test_a_latched_message_of_the_server_is_not_replaced_by_a_client(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "true"})
    client, listener, late = Node("client", remote=True), Listening(), Listening()
    graph.subscribe(listener.node, "/t", None, listener.subscriber)
    graph.publish(client, "/t", {"data": "false"}, latch=True)
    graph.remove(client)
    (kept,) = graph.subscribe(late.node, "/t", None, late.subscriber)
    assert kept.msg == {"data": "true"}
    assert listener.messages == [{"data": "false"}]


def test_topics_out_of_use_make_room_for_new_ones(graph: Graph) -> None:
    for number in range(MAX_TOPICS):
        graph.advertise(TALKER, f"/t{number}", "std_msgs/Empty")
    graph.remove(TALKER)
    graph.advertise(TALKER, "/one_more", "std_msgs/Empty")
    assert list(graph.topic_types()) == ["/one_more"]


def test_the_number_of_topics_is_bounded(graph: Graph) -> None:
    for number in range(MAX_TOPICS):
        graph.advertise(TALKER, f"/t{number}", "std_msgs/Empty")
    with pytest.raises(GraphError, match=str(MAX_TOPICS)):
        graph.advertise(TALKER, "/one_more", "std_msgs/Empty")


def data_for_newcomer(graph: Graph, topic: str = "/t") -> list[Any]:
    listener = Listening()
    kept = [published.msg["data"] for published in graph.subscribe(listener.node, topic, None, listener.subscriber)]
    graph.unsubscribe(listener.node, topic)
    return kept


def test_a_message_with_a_lifespan_reaches_subscribers_within_it(graph: Graph, clock: Clock) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    graph.publish(TALKER, "/t", {"data": "x"}, lifespan_s=1.0)
    assert data_for_newcomer(graph) == ["x"]
    clock.now_s += 1.1
    assert data_for_newcomer(graph) == []


def test_without_a_lifespan_nothing_is_kept(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    graph.publish(TALKER, "/t", {"data": "x"})
    assert data_for_newcomer(graph) == []


def test_a_latched_message_outlives_its_publisher_as_the_type_does(graph: Graph, clock: Clock) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "x"})
    graph.remove(TALKER)
    clock.now_s += UNREGISTER_TIMEOUT_S * 0.9
    assert data_for_newcomer(graph) == ["x"]
    clock.now_s += UNREGISTER_TIMEOUT_S * 0.2
    assert data_for_newcomer(graph) == []


def test_a_topic_of_a_new_type_has_nothing_of_the_old_one(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "x"})
    graph.remove(TALKER)
    for number in range(MAX_TOPICS):
        graph.advertise(TALKER, f"/t{number}", "std_msgs/Empty")
    graph.remove(TALKER)
    graph.advertise(TALKER, "/t", "std_msgs/Bool")
    assert data_for_newcomer(graph) == []


def test_a_message_too_large_to_be_latched_is_delivered_and_logged(
    graph: Graph, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topics, "MAX_LATCHED_BYTES", 100)
    listener = Listening()
    graph.subscribe(listener.node, "/t", "std_msgs/String", listener.subscriber)
    graph.publish(TALKER, "/t", {"data": "x" * 200}, latch=True)
    assert len(listener.messages) == 1
    assert "/t: too large to be latched" in caplog.text


def test_publishers_and_subscribers_of_a_topic_can_be_looked_up(graph: Graph) -> None:
    listener = Listening()
    graph.advertise(TALKER, "/t", "std_msgs/String")
    graph.subscribe(listener.node, "/t", None, listener.subscriber)
    assert graph.publishers("/t") == [TALKER]
    assert graph.subscribers("/t") == [listener.node]
    assert graph.topic_type("/t") == "std_msgs/msg/String"
    assert graph.publishers("/nobody") == graph.subscribers("/nobody") == []
    assert graph.topic_type("/nobody") is None


def test_unknown_types_are_relayed_as_they_come_where_it_is_allowed(clock: Clock) -> None:
    graph = Graph(REGISTRY, clock, relay_unknown_types=True)
    listener = Listening()
    graph.subscribe(listener.node, "/t", "acme_msgs/Thing", listener.subscriber)
    graph.publish(TALKER, "/t", {"anything": [None]})
    assert listener.messages == [{"anything": [None]}]
    assert graph.topic_types() == {"/t": "acme_msgs/msg/Thing"}
    with pytest.raises(GraphError, match="acme_msgs/Other"):
        graph.advertise(TALKER, "/t", "acme_msgs/Other")


def test_a_watcher_gets_the_messages_of_every_topic_before_their_subscribers(graph: Graph) -> None:
    seen: list[tuple[str, bool, int]] = []
    listener = Listening()
    graph.subscribe(listener.node, "/a", "std_msgs/Empty", listener.subscriber)
    graph.advertise(TALKER, "/b", "std_msgs/Empty", latch=True)
    graph.watch(lambda published, latched: seen.append((published.topic, latched, len(listener.messages))))
    graph.publish(TALKER, "/a", {})
    graph.publish(TALKER, "/b", {})
    assert seen == [("/a", False, 0), ("/b", True, 1)]


def test_a_former_watcher_gets_nothing(graph: Graph) -> None:
    seen: list[PublishedMessage] = []

    def watcher(published: PublishedMessage, _latched: bool) -> None:
        seen.append(published)

    graph.watch(watcher)
    graph.unwatch(watcher)
    graph.advertise(TALKER, "/a", "std_msgs/Empty")
    graph.publish(TALKER, "/a", {})
    assert seen == []


class TestTurnedAway:
    """Messages whose sender may not publish them."""

    @pytest.fixture
    def seen(self, graph: Graph) -> list[Any]:
        seen: list[Any] = []
        promising = Subscriber(seen.append, turned_away=lambda *told: seen.append(told))
        graph.subscribe(Node("server"), "/goal", "std_msgs/String", promising)
        return seen

    def test_a_responder_gets_the_message_its_sender_and_the_reason(self, graph: Graph, seen: list[Any]) -> None:
        graph.turn_away(TALKER, "/goal", {"data": "home"}, "not now")
        assert seen == [({"data": "home"}, TALKER, "not now")]

    def test_one_that_cannot_be_read_is_empty(self, graph: Graph, seen: list[Any]) -> None:
        graph.turn_away(TALKER, "/goal", {"data": 5}, "not now")
        assert seen == [({}, TALKER, "not now")]

    def test_nobody_else_hears_of_it(self, graph: Graph, seen: list[Any]) -> None:
        listening = Listening()
        graph.subscribe(listening.node, "/goal", None, listening.subscriber)
        graph.turn_away(TALKER, "/goal", {"data": "home"}, "not now")
        graph.turn_away(TALKER, "/unknown", {}, "not now")
        assert listening.messages == []
        assert TALKER not in graph.publishers("/goal")
        assert len(seen) == 1


def test_one_subscriber_alone_is_told(graph: Graph) -> None:
    one, other = Listening(), Listening()
    other.node = Node("other")
    graph.advertise(TALKER, "/a", "std_msgs/String")
    for listening in (one, other):
        graph.subscribe(listening.node, "/a", None, listening.subscriber)
    graph.tell(one.node, "/a", {"data": "for you"})
    assert (one.messages, other.messages) == ([{"data": "for you"}], [])


def test_a_node_that_has_not_subscribed_is_not_told(graph: Graph) -> None:
    graph.advertise(TALKER, "/a", "std_msgs/String")
    graph.tell(Node("nobody"), "/a", {"data": "for you"})
