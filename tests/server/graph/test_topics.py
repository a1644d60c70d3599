import functools
from collections.abc import Callable
from typing import Any

import pytest

from protocol.errors import MessageError
from protocol.messages import BUDGET, ListLimits
from protocol.publication import PublishedMessage
from server.errors import GraphError
from server.graph import latching, topics
from server.graph.permissions import STOP_EVENT, STOPPING, Identity, Node, Role
from server.graph.topics import MAX_TOPICS_FOR_VIEWERS, MAX_TOPICS_OF_PUBLISHER, UNREGISTER_TIMEOUT_S, Graph, Subscriber
from tests.helpers.clock import FakeClock
from tests.helpers.cost import count_calls
from tests.helpers.graph import listen
from tests.helpers.messages import REGISTRY

TALKER, LISTENER, CLIENT = Node("talker"), Node("listener"), Node("client", remote=True)
IGNORED = Subscriber(lambda _published: None)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def few_topics(monkeypatch: pytest.MonkeyPatch) -> int:
    """Number of topics that there may be."""
    monkeypatch.setattr(topics, "MAX_TOPICS", 20)
    return 20


@pytest.fixture
def graph(clock: FakeClock) -> Graph:
    return Graph(REGISTRY, clock, wall_clock=lambda: 12.5)


def test_what_is_latched_reaches_late_subscribers_alone_and_what_is_told_one_subscriber(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String")
    early = listen(graph, "/t")
    graph.latch("/t", {"data": "everything"})
    graph.publish(TALKER, "/t", {"data": "a change"})
    assert early == [{"data": "a change"}]
    assert listen(graph, "/t") == [{"data": "everything"}]
    graph.advertise(TALKER, "/a", "std_msgs/String")
    one, other = listen(graph, "/a", node=LISTENER), listen(graph, "/a")
    graph.deliver_to(LISTENER, "/a", {"data": "for you"})
    graph.deliver_to(Node("nobody"), "/a", {"data": "for nobody"})
    assert (one, other) == ([{"data": "for you"}], [])


@pytest.mark.parametrize("timeout_s", [UNREGISTER_TIMEOUT_S, 1.0])
def test_a_topic_and_its_latched_message_outlive_their_publisher_a_while(clock: FakeClock, timeout_s: float) -> None:
    graph, other = Graph(REGISTRY, clock, unregister_timeout_s=timeout_s), Node("other")
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "old"})
    graph.advertise(TALKER, "/unused", "std_msgs/String")
    graph.advertise(other, "/t", "std_msgs/String")
    graph.remove(TALKER)
    clock.now_s += 0.9 * timeout_s
    assert graph.topic_type("/unused") is not None
    assert len(listen(graph, "/t")) == 1
    # Another publisher that leaves does not revive the message.
    graph.unadvertise(other, "/t")
    clock.now_s += 0.2 * timeout_s
    graph.advertise(other, "/another", "std_msgs/String")
    assert not graph._latched_messages._sizes
    assert graph.topic_type("/unused") is None
    assert listen(graph, "/t") == []


def test_a_node_that_left_gets_nothing_and_its_topics_are_forgotten(graph: Graph) -> None:
    graph.advertise(TALKER, "/a", "std_msgs/String")
    messages = listen(graph, "/a", node=LISTENER)
    graph.subscribe(LISTENER, "/b", "std_msgs/String", IGNORED)
    graph.remove(LISTENER)
    graph.publish(TALKER, "/a", {"data": "x"})
    assert messages == []
    assert list(graph.topic_names.types()) == ["/a"]
    graph.unadvertise(TALKER, "/a")
    assert graph.topic_names.types() == {}


def test_the_refusal_of_a_topic_without_a_type_says_which_operation_can_name_one(graph: Graph) -> None:
    with pytest.raises(GraphError, match=r"topic /t: has no type yet: advertise the topic with its type first$"):
        graph.publish(TALKER, "/t", {"data": "x"})
    sentence = r"topic /t: has no type yet: subscribe with the type, or advertise the topic first$"
    with pytest.raises(GraphError, match=sentence):
        listen(graph, "/t")
    messages = listen(graph, "/t", "std_msgs/String")
    graph.publish(TALKER, "/t", {"data": "x"})
    assert messages == [{"data": "x"}]


def test_a_latched_message_of_the_server_is_not_replaced_by_a_client(graph: Graph) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "true"})
    messages = listen(graph, "/t", node=LISTENER)
    graph.publish(CLIENT, "/t", {"data": "false"}, latch=True)
    graph.remove(CLIENT)
    assert listen(graph, "/t") == [{"data": "true"}]
    assert messages == [{"data": "true"}, {"data": "false"}]


def test_a_topic_out_of_use_makes_room_without_costing_the_others_their_type(graph: Graph, few_topics: int) -> None:
    for number in range(few_topics):
        graph.advertise(TALKER, f"/t{number}", "std_msgs/Empty")
    with pytest.raises(GraphError, match=str(few_topics)):
        graph.advertise(TALKER, "/one_more", "std_msgs/Empty")
    for number in (1, 0):
        graph.unadvertise(TALKER, f"/t{number}")
    graph.advertise(TALKER, "/one_more", "std_msgs/Empty")
    assert graph.topic_type("/t1") is None
    assert graph.topic_type("/t0") is not None


def test_clients_that_may_only_look_leave_others_room_for_topics(graph: Graph) -> None:
    viewer = Node("viewer", remote=True, identity=Identity("screen", Role.VIEW))
    for number in range(MAX_TOPICS_FOR_VIEWERS):
        graph.subscribe(viewer, f"/t{number}", "std_msgs/Empty", IGNORED)
    with pytest.raises(GraphError, match=f"the limit for the role view is {MAX_TOPICS_FOR_VIEWERS}"):
        graph.subscribe(viewer, "/one_more", "std_msgs/Empty", IGNORED)
    graph.advertise(CLIENT, "/one_more", "std_msgs/Empty")
    graph.subscribe(viewer, "/one_more", "std_msgs/Empty", IGNORED)


def test_the_topics_that_a_client_publishes_on_without_advertising_them_are_bounded(graph: Graph) -> None:
    for number in range(MAX_TOPICS_OF_PUBLISHER + 1):
        graph.advertise(TALKER, f"/t{number}", "std_msgs/Empty")
    for number in range(MAX_TOPICS_OF_PUBLISHER):
        graph.publish(CLIENT, f"/t{number}", {})
    with pytest.raises(GraphError, match=f"publishes on {MAX_TOPICS_OF_PUBLISHER} topics already"):
        graph.publish(CLIENT, f"/t{MAX_TOPICS_OF_PUBLISHER}", {})
    graph.publish(CLIENT, "/t0", {})
    heard: list[Any] = []
    graph.subscribe(TALKER, "/stop", "std_msgs/Empty", Subscriber(heard.append, rule=STOPPING))
    graph.publish(CLIENT, "/stop", {})
    assert heard


def test_a_message_that_does_not_fit_stops_all_the_same(graph: Graph) -> None:
    heard: list[Any] = []
    graph.subscribe(TALKER, "/stop", "std_msgs/Empty", Subscriber(heard.append, rule=STOPPING))
    graph.subscribe(TALKER, "/event", "std_msgs/String", Subscriber(heard.append, rule=STOP_EVENT))
    graph.publish(CLIENT, "/stop", {"data": False})
    with pytest.raises(MessageError):
        graph.publish(CLIENT, "/event", {"data": False})
    assert [(each.topic, each.msg) for each in heard] == [("/stop", {})]


def come_and_go(graph: Graph, client: Node) -> None:
    graph.subscribe(client, "/t1", None, IGNORED)
    graph.services.call(client, "/s1", {}, lambda _response: None)
    graph.services.offer_calls(client, "/of_client", "std_srvs/Trigger", lambda _call: None)
    graph.remove(client)


STEPS: dict[str, Callable[[Graph, Node], object]] = {
    "come and go": come_and_go,
    "publish once": lambda graph, client: graph.publish(client, "/t1", {}),
    "advertise a new topic": lambda graph, client: graph.advertise(client, "/new", "std_msgs/Empty"),
}


@pytest.mark.parametrize("step", STEPS)
def test_a_step_costs_the_same_however_much_others_do(step: str) -> None:
    costs = []
    for others in (10, 1000):
        graph, client = Graph(REGISTRY, call_later=FakeClock().call_later), Node("client", remote=True)
        for number in range(others):
            other = Node(f"other {number}", remote=True)
            graph.advertise(other, f"/t{number}", "std_msgs/Empty")
            graph.subscribe(other, f"/t{number}", None, IGNORED)
            graph.services.offer_calls(other, f"/s{number}", "std_srvs/Trigger", lambda _call: None)
            graph.services.call(other, f"/s{number}", {}, lambda _response: None)
            graph.actions.offer(other, f"/a{number}", "control_msgs/PointHead", lambda _goal: None)
        graph.advertise(client, "/unused", "std_msgs/Empty")
        graph.unadvertise(client, "/unused")
        costs.append(count_calls(functools.partial(STEPS[step], graph, client)))
    assert costs[0] == costs[1]


def test_a_topic_of_a_new_type_has_nothing_of_the_old_one(graph: Graph, few_topics: int) -> None:
    graph.advertise(TALKER, "/t", "std_msgs/String", latch=True)
    graph.publish(TALKER, "/t", {"data": "x"})
    graph.remove(TALKER)
    for number in range(few_topics):
        graph.advertise(TALKER, f"/t{number}", "std_msgs/Empty")
    graph.remove(TALKER)
    graph.advertise(TALKER, "/t", "std_msgs/Bool")
    assert listen(graph, "/t") == []


def test_a_message_too_large_to_be_latched_is_delivered_and_logged(
    graph: Graph, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latching, "MAX_SERVER_LATCHED_BYTES", 100)
    messages = listen(graph, "/t", "std_msgs/String")
    graph.publish(TALKER, "/t", {"data": "x" * 200}, latch=True)
    assert len(messages) == 1
    assert "/t: not latched: the server has 211 bytes latched with it, the limit is 100" in caplog.text


def test_a_watcher_gets_the_messages_of_every_topic_before_their_subscribers(graph: Graph) -> None:
    seen: list[tuple[str, bool, int]] = []
    messages = listen(graph, "/a", "std_msgs/Empty")
    graph.advertise(TALKER, "/b", "std_msgs/Empty", latch=True)

    def watcher(published: PublishedMessage, latched: bool) -> None:
        seen.append((published.topic, latched, len(messages)))

    graph.watch(watcher)
    graph.publish(TALKER, "/a", {})
    graph.publish(TALKER, "/b", {})
    graph.unwatch(watcher)
    graph.publish(TALKER, "/a", {})
    assert seen == [("/a", False, 0), ("/b", True, 1)]


def test_every_change_of_who_uses_a_topic_counts_and_a_message_does_not() -> None:
    graph, first, second = Graph(REGISTRY, call_later=FakeClock().call_later), Node("first"), Node("second")
    graph.advertise(first, "/a", "std_msgs/String")
    changes: list[Callable[[], object]] = [
        lambda: graph.advertise(second, "/a", "std_msgs/String"),
        lambda: graph.advertise(second, "/a", "std_msgs/String", latch=True),
        lambda: graph.publish(first, "/a", {"data": "x"}, latch=True),
        lambda: graph.subscribe(second, "/a", None, IGNORED),
        lambda: graph.unsubscribe(second, "/a"),
        lambda: graph.unadvertise(second, "/a"),
        lambda: graph.remove(first),
        lambda: graph.advertise(first, "/a", "std_msgs/String"),
    ]
    for number, change in enumerate(changes):
        before = graph.revision
        change()
        assert graph.revision > before, number
    before = graph.revision
    graph.publish(first, "/a", {"data": "x"})
    assert graph.revision == before


def test_names_are_compared_a_few_times_a_second_however_many_are_wrong(graph: Graph, clock: FakeClock) -> None:
    graph.subscribe(Node("server"), "/moveit_goal_named", "std_msgs/String", IGNORED)
    hints = [graph.topic_hint("/moveit_goal_nmaed") for _ in range(topics.COMPARISONS_AT_ONCE + 1)]
    assert hints == ["; did you mean /moveit_goal_named?"] * topics.COMPARISONS_AT_ONCE + [""]
    clock.now_s += 1.0
    assert graph.topic_hint("/moveit_goal_nmaed") == hints[0]


POSES = "geometry_msgs/msg/PoseArray"


def test_a_reader_s_limits_refuse_a_message_before_it_is_completed_and_end_with_its_subscription(graph: Graph) -> None:
    refused: list[str] = []
    limits = ListLimits({f"{POSES}.poses": 2})
    subscriber = Subscriber(IGNORED.deliver, lambda error: refused.append(str(error)), limits=limits)
    graph.subscribe(LISTENER, "/poses", POSES, subscriber)
    with pytest.raises(MessageError):
        graph.publish(CLIENT, "/poses", {"poses": [{}] * 3})
    assert refused == ["field poses: wanted at most 2 elements in all, got 3"]
    assert BUDGET.taken == 0
    graph.subscribe(CLIENT, "/poses", None, IGNORED)
    graph.unsubscribe(LISTENER, "/poses")
    graph.publish(CLIENT, "/poses", {"poses": [{}] * 3})


def test_no_frame_is_read_by_itself_for_a_reader_with_limits(graph: Graph) -> None:
    graph.advertise(CLIENT, "/texts", "std_msgs/msg/String")
    assert graph.strict_reader(CLIENT, "/texts") is not None
    graph.subscribe(LISTENER, "/texts", None, Subscriber(IGNORED.deliver, limits=ListLimits()))
    assert graph.strict_reader(CLIENT, "/texts") is None
