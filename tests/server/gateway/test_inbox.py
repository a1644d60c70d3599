"""Order, turns and stops of what one client sends, with time and threads as arguments."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import png
from protocol.operations import Auth, CallService, Operation, Publish, peek
from protocol.registry import Registry
from protocol.session import Packed, Refusal, Session
from server.gateway.client_topics import StrictPublication, StrictTopic
from server.gateway.inbox import LONG_FRAME_BYTES, MAX_WAITING, STOP_PERIOD_S, Inbox, Scheduling
from server.gateway.turns import ROUND_S, TURN_S, Turns
from server.graph.message_types import MessageTypes, PostponedError, ReceivedMessage
from tests.helpers.clock import FakeClock
from tests.helpers.gateway import UnreadSocket

TYPES = MessageTypes(Registry.load())
READER = TYPES.strict_reader("std_msgs/msg/String")


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

    Publishing on ``/goal`` moves the arm, on ``/stop`` stops it; ``/large`` is completed in the background.
    """

    def __init__(self) -> None:
        self.clock = FakeClock()
        self._soon: deque[Callable[[], object]] = deque()
        self.turns = Turns(self._soon.append, self.clock)
        self.threads = Later()
        self.done: list[str] = []

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
        self.changed_topics: set[str] = set()
        self.session = Session()
        self.socket = UnreadSocket()
        scheduling = Scheduling(world.turns, world.threads, world.clock.call_later)
        self.inbox = Inbox(self, self.session, TYPES, scheduling, self.socket, world.clock)

    def admit_frame(self, frame: str | bytes) -> bool:
        return True

    def admit_first(self, items: Sequence[Operation | Refusal | Packed]) -> bool:
        return True

    def read_strictly(self, frame: str) -> StrictPublication | None:
        operation = peek(frame)
        if isinstance(operation, Publish) and operation.topic.startswith("/strict"):
            return StrictPublication(frame, StrictTopic(operation.topic, operation.topic, 0, READER), b"")
        return None

    def publish_strictly(self, publication: StrictPublication) -> bool:
        if publication.topic.name in self.changed_topics:
            return False
        self._world.done.append(f"{self._name}{publication.topic.name}")
        self._world.clock.advance(self._step_s)
        return True

    def carry_out(
        self, item: Operation | Refusal, size_bytes: int, message: ReceivedMessage | None, *, light: bool = False
    ) -> None:
        if isinstance(item, Publish) and item.topic == "/large":
            received = message or ReceivedMessage(item.msg, size_bytes)
            if received.completed("std_msgs/msg/String") is None:
                raise PostponedError(received, "std_msgs/msg/String")
        self._note(item)
        if isinstance(item, Auth):
            self.identified = True

    def is_stop(self, operation: Operation) -> bool:
        return isinstance(operation, Publish) and operation.topic == "/stop"

    def is_driving(self, operation: Operation) -> bool:
        return isinstance(operation, Publish) and operation.topic == "/goal"

    def reject(self, operation: Operation, reason: str) -> None:
        self._note(operation, "no ")

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


def test_what_comes_while_nothing_waits_is_carried_out_at_once(world: World) -> None:
    world.client().publish("/a")
    assert world.done == ["/a"]


def test_a_frame_of_many_operations_is_carried_out_a_turn_at_a_time(world: World) -> None:
    client = world.client(step_s=TURN_S / 4)
    client.publish(*["/a"] * 100)
    assert len(world.done) <= 5
    for _ in range(3):
        before = len(world.done)
        world.turn()
        assert 0 < len(world.done) - before <= ROUND_S / TURN_S * 5
    world.run()
    assert world.done == ["/a"] * 100


def test_another_client_has_its_turn_in_between(world: World) -> None:
    world.client("a ", TURN_S / 4).publish(*["/a"] * 100)
    world.client("b ", TURN_S / 4).publish(*["/b"] * 3)
    world.turn()
    world.turn()
    assert world.done.count("b /b") == 3
    assert world.done.count("a /a") < 50


def test_what_comes_behind_waits_in_order(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish("/1", "/2", "/3")
    client.publish("/4")
    client.publish("/5", length=LONG_FRAME_BYTES)
    client.publish("/6")
    world.run()
    assert world.done == [f"/{number}" for number in range(1, 7)]


def test_what_is_published_strictly_keeps_its_place(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish("/1", "/2")
    client.publish("/strict3")
    client.publish("/4", length=LONG_FRAME_BYTES)
    client.publish("/strict5")
    client.publish("/6")
    world.run()
    client.publish("/strict7")
    assert world.done == ["/1", "/2", "/strict3", "/4", "/strict5", "/6", "/strict7"]


def test_a_stop_goes_ahead_of_what_is_published_strictly(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    for _ in range(20):
        client.publish("/strict")
    client.publish("/stop")
    assert world.done == ["/strict"] * 2 + ["/stop"]
    world.run()
    assert world.done.count("/strict") == 20


def test_what_cannot_be_published_strictly_any_more_is_read_the_general_way(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish("/1", "/2")
    client.publish("/strict3")
    client.publish("/4")
    client.changed_topics.update(("/strict3", "/strict5"))
    world.run()
    client.publish("/strict5")
    assert world.done == ["/1", "/2", "/strict3", "/4", "/strict5"]


def test_a_long_frame_of_few_values_is_carried_out_at_once(world: World) -> None:
    world.client().inbox.receive_frame(json.dumps({"op": "publish", "topic": "/a", "msg": {"data": "x" * 1_000_000}}))
    assert world.done == ["/a"]


def test_a_stop_goes_ahead_of_its_clients_own_operations_and_those_move_nothing_any_more(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish(*["/a", "/goal"] * 10)
    client.publish("/stop")
    assert world.done[-1] == "/stop"
    assert "no /goal" not in world.done
    world.run()
    assert world.done.count("/a") == 10
    assert "/goal" not in world.done[world.done.index("/stop") :]
    assert world.done.count("/goal") + world.done.count("no /goal") == 10


def test_a_goal_and_a_stop_right_behind_it_keep_their_order(world: World) -> None:
    client = world.client(step_s=2 * ROUND_S)
    client.publish("/a")
    client.publish("/goal", "/stop")
    client.publish("/goal")
    client.publish("/stop")
    world.run()
    assert world.done == ["/a", "/goal", "/stop", "/goal", "/stop"]


def test_a_stop_at_the_end_of_a_long_frame_goes_ahead_of_it(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish(*["/goal"] * 999, "/stop")
    world.turn()
    world.threads.work()
    assert world.done == ["/stop"]
    world.run()
    assert world.done == ["/stop"] + ["no /goal"] * 999


def test_of_many_stops_one_goes_ahead_and_what_was_before_any_of_them_moves_nothing(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish(*["/goal", "/stop"] * 100)
    before_s = world.clock()
    assert world.done.count("/stop") == 1
    client.publish("/goal")
    client.publish("/stop")
    assert world.clock() - before_s <= 2 * ROUND_S
    world.run()
    assert world.done.count("/stop") == 101
    assert "/goal" not in world.done[world.done.index("/stop") :]


def test_a_stop_overtakes_what_a_thread_works_on(world: World) -> None:
    client = world.client()
    client.publish("/large")
    for _ in range(5):
        client.publish("/goal")
    client.publish("/stop")
    assert world.done == ["/stop"]
    world.run()
    assert world.done == ["/stop", "/large"] + ["no /goal"] * 5


def test_what_comes_behind_a_frame_that_a_thread_reads_is_read_after_it(world: World) -> None:
    client = world.client()
    client.publish("/1", length=LONG_FRAME_BYTES)
    world.turn()
    client.inbox.receive_frame('{"op":"publish",')
    client.inbox.receive_frame('"topic":"/2"}')
    client.publish("/3")
    assert world.done == []
    world.run()
    assert world.done == ["/1", "/2", "/3"]


def test_a_stop_overtakes_frames_that_are_not_read_yet(world: World) -> None:
    client = world.client()
    client.publish("/goal", length=LONG_FRAME_BYTES)
    client.publish("/goal")
    client.publish("/stop")
    assert world.done == ["/stop"]
    world.run()
    assert world.done == ["/stop", "no /goal", "no /goal"]


def test_what_is_behind_a_message_completed_in_the_background_waits_for_it(world: World) -> None:
    client = world.client()
    client.publish("/large")
    client.publish("/b")
    assert world.done == []
    world.run()
    assert world.done == ["/large", "/b"]


def test_a_client_has_the_threads_for_half_of_the_time_at_most(world: World) -> None:
    client = world.client()
    client.publish("/large")
    client.publish("/large")
    world.threads.work(cost_s=1.0)
    world.turn()
    assert not world.threads.jobs
    world.clock.advance(0.9)
    assert not world.threads.jobs
    world.clock.advance(0.2)
    world.run()
    assert world.done == ["/large", "/large"]


def test_a_socket_is_not_read_while_much_waits(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    for _ in range(MAX_WAITING + 3):
        client.publish("/a")
    assert client.socket.held
    world.run()
    assert not client.socket.held
    assert len(world.done) == MAX_WAITING + 3


def test_a_client_that_is_closed_has_nothing_carried_out(world: World) -> None:
    client = world.client(step_s=ROUND_S)
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
    client.publish("/stop")
    world.run()
    assert world.done == ["/a", "/stop"]
    client.publish(*["/b"] * 10)
    world.run()
    assert world.done == ["/a", "/stop"]
    while client.session.data_to_send(world.clock()):
        pass
    client.inbox.resume()
    world.run()
    assert world.done == ["/a", "/stop", *["/b"] * 10]


def test_a_picture_is_unpacked_by_a_thread(world: World) -> None:
    client = world.client()
    inside = json.dumps({"op": "publish", "topic": "/inside"})
    client.inbox.receive_frame(json.dumps({"op": "png", "data": png.encode(inside.encode())}))
    world.turn()
    assert world.done == []
    world.run()
    assert world.done == ["/inside"]


def test_before_a_client_is_identified_nothing_is_read_ahead(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.identified = False
    client.inbox.receive_frame(
        json.dumps({"op": "auth", "token": "t"}) + json.dumps({"op": "set_level", "level": "none"})
    )
    client.publish("/stop")
    world.run()
    assert world.done == ["auth", "set_level", "/stop"]


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
def test_whatever_one_client_sends_anothers_stop_is_carried_out_when_it_comes(
    steps: list[tuple[str, list[str]]],
) -> None:
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


def test_a_call_that_is_no_stop_waits_its_turn(world: World) -> None:
    client = world.client(step_s=ROUND_S)
    client.publish("/a", "/b")
    client.inbox.receive_frame(json.dumps({"op": "call_service", "service": "/c"}))
    assert CallService(service="/c").op not in world.done
    world.run()
    assert world.done == ["/a", "/b", "call_service"]
