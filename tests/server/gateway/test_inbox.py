"""Order, turns and stops of what one client sends, with time and threads as arguments."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import png
from protocol.operations import Auth, CancelActionGoal, Operation, Publish
from protocol.session import Packed, Refusal, Session
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import ACTIONLIB_CANCEL
from server.arrival import arrival_epoch
from server.gateway.inbox import LONG_FRAME_BYTES, MAX_WAITING, STOP_PERIOD_S, STOP_TURN_S, Inbox, Waiting
from server.gateway.turns import LEAST_WAITING_BYTES, ROUND_S, TURN_S, Turns
from server.graph.actions import CANCEL_SERVICE
from server.graph.message_types import MessageTypes, PostponedError, ReceivedMessage
from server.graph.permissions import CANCELLING, STOPPING
from tests.helpers.clock import FakeClock
from tests.helpers.gateway import UnreadSocket
from tests.helpers.messages import REGISTRY
from tests.helpers.rules import server_rules

TYPES = MessageTypes(REGISTRY)


class Later:
    """Threads that work when they are told to."""

    def __init__(self) -> None:
        self.jobs: deque[tuple[Callable[[], Any], Callable[[Any, float], None]]] = deque()

    def run(self, job: Callable[[], Any], done: Callable[[Any, float], None], failed: Callable[[], None]) -> None:
        self.jobs.append((job, done))

    def encode(self, encoded: object, ready: Callable[[], None]) -> None:
        raise AssertionError("an inbox encodes nothing")

    def work(self, cost_s: float = 0.0) -> None:
        job, done = self.jobs.popleft()
        done(job(), cost_s)


class World:
    """Clients whose operations take time, on an event loop that turns when it is told to.

    Publishing on ``/goal`` moves the arm unless a stop has overtaken it, on ``/stop`` stops it, on ``/cancel`` cancels
    a goal; ``/large`` is completed in the background.
    """

    def __init__(self) -> None:
        self.clock = FakeClock()
        self._soon: deque[Callable[[], object]] = deque()
        self.threads = Later()
        self.turns = Turns(self._soon.append, self.clock, self.threads, self.clock.call_later)
        self.done: list[str] = []
        self.last_stop = 0

    def client(self, name: str = "", step_s: float = 0.0) -> Handler:
        return Handler(self, name, step_s)

    def turn(self) -> None:
        for _ in range(len(self._soon)):
            self._soon.popleft()()

    def run(self) -> None:
        while self._soon or self.threads.jobs:
            self.turn()
            while self.threads.jobs:
                self.threads.work()


class Handler:
    """A client, and what it has done."""

    def __init__(self, world: World, name: str, step_s: float) -> None:
        self._world, self._name, self._step_s = world, name, step_s
        self.identified = True
        self.session = Session()
        self.socket = UnreadSocket()
        context = SimpleNamespace(
            session=self.session,
            graph=SimpleNamespace(
                message_types=TYPES,
                rules={"/stop": STOPPING, "/cancel": CANCELLING},
                services=SimpleNamespace(rules={}),
                actions=SimpleNamespace(rules={}),
            ),
            gateway=SimpleNamespace(turns=world.turns),
            transport=self.socket,
            clock=world.clock,
        )
        self.inbox = Inbox(self, context)

    def read(self, frame: str | bytes) -> Sequence[Operation | Refusal | Packed]:
        return self.session.receive_frame(frame, self._world.clock())

    def publish_strictly(self, frame: str) -> bool:
        operation = self.session.peek(frame)
        is_strict = isinstance(operation, Publish) and operation.topic.startswith("/strict")
        if operation is not None and is_strict:
            self._note(operation)
        return is_strict

    def carry_out(self, item: Operation | Refusal, waiting: Waiting) -> None:
        if isinstance(item, Publish) and item.topic == "/large":
            received = waiting.message or ReceivedMessage(item.msg, waiting.size_bytes)
            if received.completed("std_msgs/msg/String") is None:
                raise PostponedError(received, "std_msgs/msg/String")
        if isinstance(item, Publish) and item.topic == "/stop":
            self._world.last_stop = STOP_EPOCHS.begin()
        overtaken = isinstance(item, Publish) and item.topic == "/goal" and arrival_epoch() < self._world.last_stop
        self._note(item, "no " if overtaken else "")
        if isinstance(item, Auth):
            self.identified = True

    def repeat(self, operation: Operation) -> None:
        self._note(operation, "again ")

    def _note(self, item: Operation | Refusal, prefix: str = "") -> None:
        what = item.topic if isinstance(item, Publish) else item.op or "refusal"
        self._world.done.append(f"{self._name}{prefix}{what}")
        self._world.clock.advance(self._step_s)

    def publish(self, *topics: str, length: int = 0) -> None:
        """Publish on topics, in one frame; a long one is read by a thread."""
        operations = [json.dumps({"op": "publish", "topic": topic, "msg": {"data": "," * length}}) for topic in topics]
        self.inbox.receive_frame("".join(operations))


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
def client(world: World) -> Handler:
    """A client each of whose operations takes a round."""
    return world.client(step_s=ROUND_S)


def test_a_frame_of_many_operations_is_carried_out_a_turn_at_a_time_with_others_in_between(world: World) -> None:
    client = world.client(step_s=TURN_S / 4)
    client.publish(*["/a"] * 100)
    assert len(world.done) <= 5
    for _ in range(3):
        before = len(world.done)
        world.turn()
        assert 0 < len(world.done) - before <= ROUND_S / TURN_S * 5
    world.run()
    assert world.done == ["/a"] * 100
    world.client("a ", TURN_S / 4).publish(*["/a"] * 100)
    world.client("b ", TURN_S / 4).publish(*["/b"] * 3)
    world.turn()
    world.turn()
    assert world.done.count("b /b") == 3
    assert world.done.count("a /a") < 50


def test_what_comes_behind_waits_in_order(world: World, client: Handler) -> None:
    client.publish("/1", "/2", "/3")
    client.publish("/strict4")
    client.publish("/5")
    # A thread reads it; the next message comes in two frames.
    client.publish("/6", length=LONG_FRAME_BYTES)
    client.inbox.receive_frame('{"op":"publish",')
    client.inbox.receive_frame('"topic":"/strict7"}')
    client.publish("/8")
    client.inbox.receive_frame(json.dumps({"op": "call_service", "service": "/c"}))
    world.run()
    client.publish("/strict9")
    expected = ["/1", "/2", "/3", "/strict4", "/5", "/6", "/strict7", "/8", "call_service", "/strict9"]
    assert world.done == expected


def test_a_stop_goes_ahead_of_what_is_published_strictly(world: World, client: Handler) -> None:
    for _ in range(20):
        client.publish("/strict")
    client.publish("/stop")
    assert world.done == ["/strict"] * 2 + ["/stop"]
    world.run()
    assert world.done.count("/strict") == 20


def test_a_long_frame_of_few_values_is_carried_out_at_once(world: World) -> None:
    world.client().inbox.receive_frame('{"op":"publish","topic":"/a","msg":{"data":"%s"}}' % ("x" * 1_000_000))
    assert world.done == ["/a"]


def test_a_stop_goes_ahead_of_its_clients_own_operations_and_those_move_nothing(world: World, client: Handler) -> None:
    client.publish(*["/a", "/goal"] * 10)
    client.publish("/stop")
    assert world.done[-1] == "/stop"
    assert "no /goal" not in world.done
    world.run()
    assert world.done.count("/a") == 10
    assert "/goal" not in world.done[world.done.index("/stop") :]
    assert world.done.count("/goal") + world.done.count("no /goal") == 10


def test_a_goal_that_waits_when_another_clients_stop_comes_moves_nothing(world: World) -> None:
    client = world.client(step_s=2 * ROUND_S)
    client.publish("/a")
    client.publish("/goal")
    world.turn()
    world.clock.advance(ROUND_S)
    client.publish("/a", "/goal")
    world.client("other ").publish("/stop")
    world.run()
    assert world.done.index("other /stop") < world.done.index("no /goal")
    assert "/goal" not in world.done[world.done.index("other /stop") :]


def test_a_frame_that_waits_when_another_clients_stop_comes_is_not_published_strictly(
    world: World, client: Handler, monkeypatch: pytest.MonkeyPatch
) -> None:
    client.publish("/a", "/a", "/a")
    client.publish("/goal")
    world.turn()
    world.clock.advance(ROUND_S)
    world.client("other ").publish("/stop")
    monkeypatch.setattr(client, "publish_strictly", lambda _frame: pytest.fail("it is as old as the goal"))
    world.run()
    assert world.done[-1] == "no /goal"


def test_a_stop_at_the_end_of_a_long_frame_goes_ahead_of_it(world: World, client: Handler) -> None:
    client.publish(*["/goal"] * 999, "/stop")
    while not world.threads.jobs:
        world.turn()
    world.threads.work()
    assert world.done == ["/stop"]
    world.run()
    assert world.done == ["/stop"] + ["no /goal"] * 999


def test_stops_that_come_faster_are_carried_out_one_after_the_other_in_a_share_of_the_time(world: World) -> None:
    client = world.client(step_s=STOP_TURN_S / 4)
    client.publish(*["/goal", "/stop"] * 20)
    assert world.done.count("/stop") == 1
    for period in range(1, 6):
        world.clock.advance(STOP_PERIOD_S)
        assert world.done.count("/stop") <= 1 + 5 * period
    world.run()
    assert (world.done.count("/stop"), world.done.count("no /goal")) == (20, 20)


def test_a_flood_of_stops_is_not_read_beyond_the_bound_and_ends_with_its_client(world: World) -> None:
    client = world.client(step_s=STOP_TURN_S)
    for _ in range(MAX_WAITING + 5):
        client.publish("/stop")
    assert client.socket.held
    client.inbox.close()
    done = len(world.done)
    world.clock.advance(STOP_PERIOD_S)
    assert len(world.done) == done


def test_the_names_of_all_stops_and_cancels_have_a_word_that_is_looked_for_in_unread_frames() -> None:
    services, topics, _ = server_rules()
    rules = {**services, **topics}
    urgent = [name for name, rule in rules.items() if rule.stops and rule.at_once_data is None]
    assert len(urgent) > 5
    for name in (*urgent, CANCEL_SERVICE, ACTIONLIB_CANCEL, CancelActionGoal.model_fields["op"].default, "stop"):
        assert "stop" in name or "cancel" in name


def test_a_stop_goes_ahead_of_two_megabytes_that_its_client_sent_before(world: World, client: Handler) -> None:
    for _ in range(130):
        client.publish("/goal", length=15_000)
    assert not client.socket.held
    client.publish("/stop")
    assert world.done[-1] == "/stop"
    world.run()
    assert "/goal" not in world.done[world.done.index("/stop") :]


def test_a_stop_goes_ahead_of_frames_each_of_which_takes_longer_than_a_turn(world: World, client: Handler) -> None:
    for _ in range(20):
        client.publish("/goal")
        world.turn()
    client.publish("/stop")
    assert world.done == ["/goal", "/stop"]
    world.run()
    assert world.done[2:] == ["no /goal"] * 19


def test_where_all_clients_send_much_the_sockets_are_read_less(world: World) -> None:
    senders = [world.client(step_s=ROUND_S) for _ in range(5)]
    world.client(step_s=ROUND_S).publish("/a")
    for client in senders:
        while not client.socket.held:
            client.publish("/a", length=LONG_FRAME_BYTES * 60)
    late = world.client(step_s=ROUND_S)
    late.publish("/a", length=LONG_FRAME_BYTES)
    late.publish("/a", length=LEAST_WAITING_BYTES)
    assert late.socket.held
    for client in senders:
        client.inbox.close()
    world.run()
    assert not late.socket.held


def test_a_cancel_goes_ahead_and_is_carried_out_in_its_turn_as_well(world: World, client: Handler) -> None:
    client.publish("/a", "/a", "/goal")
    client.publish("/cancel")
    assert world.done[-1] == "/cancel"
    world.run()
    assert world.done[-2:] == ["/goal", "again /cancel"]
    assert world.done.count("/cancel") == 1


@pytest.mark.parametrize(
    ("first", "length", "carried_out"), [("/large", 0, "/large"), ("/goal", LONG_FRAME_BYTES, "no /goal")]
)
def test_a_stop_overtakes_what_is_still_with_a_thread(world: World, first: str, length: int, carried_out: str) -> None:
    client = world.client()
    client.publish(first, length=length)
    for _ in range(5):
        client.publish("/goal")
    client.publish("/stop")
    assert world.done == ["/stop"]
    world.run()
    assert world.done == ["/stop", carried_out] + ["no /goal"] * 5


def test_a_client_has_the_threads_for_half_of_the_time_at_most(world: World) -> None:
    client = world.client()
    client.publish("/large")
    client.publish("/large")
    world.threads.work(cost_s=1.0)
    for _ in range(5):
        world.turn()
    assert world.done == ["/large"]
    assert not world.threads.jobs
    world.clock.advance(0.9)
    assert not world.threads.jobs
    world.clock.advance(0.2)
    assert len(world.threads.jobs) == 1
    world.run()
    assert world.done == ["/large", "/large"]


def test_a_socket_is_not_read_while_much_waits_nor_carried_out_after_its_end(world: World, client: Handler) -> None:
    for _ in range(MAX_WAITING + 3):
        client.publish("/a")
    assert client.socket.held
    world.run()
    assert not client.socket.held
    assert len(world.done) == MAX_WAITING + 3
    client.publish(*["/a"] * 10)
    done = len(world.done)
    client.inbox.close()
    client.publish("/b")
    world.run()
    assert len(world.done) == done


def test_operations_wait_until_their_client_has_read_its_replies(world: World) -> None:
    client = world.client()
    while not client.session.congested:
        client.session.reply({"op": "service_response", "values": "x" * 10_000})
    client.publish("/a")
    world.run()
    assert world.done == []
    for _ in range(3):
        client.publish("/stop")
        world.clock.advance(STOP_PERIOD_S)
    assert world.done == ["/stop"] * 3
    while client.session.data_to_send(world.clock()):
        pass
    client.inbox.resume()
    world.run()
    assert world.done == ["/stop"] * 3 + ["/a"]


def test_a_picture_is_unpacked_by_a_thread(world: World) -> None:
    client = world.client()
    inside = json.dumps({"op": "publish", "topic": "/inside"})
    client.inbox.receive_frame(json.dumps({"op": "png", "data": png.encode(inside.encode())}))
    world.turn()
    assert world.done == []
    world.run()
    assert world.done == ["/inside"]


def test_before_a_client_is_identified_nothing_is_read_ahead(world: World, client: Handler) -> None:
    client.identified = False
    client.inbox.receive_frame(
        json.dumps({"op": "auth", "token": "t"}) + json.dumps({"op": "set_level", "level": "none"})
    )
    client.publish("/stop")
    world.run()
    assert world.done == ["auth", "/stop", "set_level"]


STEP_S = 3 * TURN_S
actions = st.lists(
    st.one_of(
        st.tuples(st.just("frame"), st.lists(st.sampled_from(["/a", "/goal", "/large", "/stop"]), max_size=40)),
        st.tuples(st.just("long"), st.lists(st.sampled_from(["/a", "/goal", "/large"]), min_size=1, max_size=5)),
        st.tuples(st.sampled_from(["turn", "threads"]), st.just([])),
    ),
    max_size=30,
)


@given(actions)
def test_a_stop_is_carried_out_when_it_comes_whatever_another_client_sends(steps: list[tuple[str, list[str]]]) -> None:
    world = World()
    attacker, other = world.client("attacker ", STEP_S), world.client("other ")
    for kind, topics in steps:
        if kind == "turn":
            before_s = world.clock()
            world.turn()
            # A round, the step that goes beyond it, and the few operations that go before a stop.
            assert world.clock() - before_s <= 2 * (ROUND_S + 6 * STEP_S)
        elif kind == "threads" and world.threads.jobs:
            world.threads.work()
        elif topics:
            attacker.publish(*topics, length=LONG_FRAME_BYTES if kind == "long" else 0)
        world.clock.advance(STOP_PERIOD_S)
        before_s = world.clock()
        other.publish("/stop")
        assert world.done[-1] == "other /stop"
        assert world.clock() == before_s
