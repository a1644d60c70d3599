from __future__ import annotations

import pytest

from protocol.errors import FrameError
from protocol.limits import Limits
from protocol.session import Session
from server.access.permissions import Identity, Role
from server.graph import latching
from server.graph.node import Node
from server.graph.topics import Subscriber
from tests.helpers.gateway import InProcess


@pytest.fixture
def world() -> InProcess:
    return InProcess(Limits(max_subscriptions=2, max_publications=2))


@pytest.mark.parametrize("op", ["subscribe", "advertise"])
def test_an_operation_over_the_limit_leaves_no_trace_in_the_graph(
    world: InProcess, op: str, caplog: pytest.LogCaptureFixture
) -> None:
    for topic in ("/a", "/b", "/c"):
        world.say("x", op=op, topic=topic, type="std_msgs/String")
    assert list(world.graph.topic_types()) == ["/a", "/b"]
    assert "limit is 2" in caplog.text


def test_an_operation_at_the_limit_keeps_what_the_client_has_on_that_topic(world: InProcess) -> None:
    for mark in ("1", "2", "3"):
        world.say("x", op="subscribe", topic="/a", type="std_msgs/String", id=mark)
    world.say("y", op="publish", topic="/a", msg={"data": "hello"})
    assert len(world.heard("x")) == 1


async def test_a_client_that_left_gets_nothing(world: InProcess) -> None:
    world.say("x", op="subscribe", topic="/a", type="std_msgs/String")
    left = world.client("x")
    await world.close("x")
    world.say("y", op="publish", topic="/a", msg={"data": "late"})
    assert left.session.data_to_send(world.clock()) == []


def test_publish_makes_the_client_a_publisher(world: InProcess) -> None:
    world.say("x", op="subscribe", topic="/a", type="std_msgs/String")
    world.say("y", op="publish", topic="/a", msg={"data": "hello"})
    assert world.graph.publishers("/a") == [world.client("y").node]


def test_a_message_that_cannot_be_encoded_for_one_reaches_the_others(
    world: InProcess, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    deliver = Session.deliver

    def deliver_or_fail(session: Session, *arguments: object) -> None:
        if session is world.client("broken").session:
            raise FrameError("cannot be encoded")
        deliver(session, *arguments)  # type: ignore[arg-type]

    for name in ("broken", "whole"):
        world.say(name, op="subscribe", topic="/a", type="std_msgs/String")
    monkeypatch.setattr(Session, "deliver", deliver_or_fail)
    world.say("y", op="publish", topic="/a", msg={"data": "hello"})
    assert len(world.heard("whole")) == 1
    assert "broken: refused: subscribe: cannot be encoded" in caplog.text


class TestLatching:
    """What is told to clients of messages that are not latched."""

    def test_a_viewers_stop_stops_and_is_not_latched(self, world: InProcess) -> None:
        stopped: list[object] = []
        server = Node("server")
        world.graph.subscribe(server, "/trajectory_execution_event", "std_msgs/String", Subscriber(stopped.append))
        world.enter("screen", Identity("screen", Role.VIEW))
        world.say("screen", op="set_level", level="warning")
        event = {"topic": "/trajectory_execution_event", "latch": True}
        world.say("screen", op="advertise", type="std_msgs/String", **event)
        world.say("screen", op="publish", msg={"data": "stop"}, **event)
        assert len(stopped) == 1
        assert not world.graph.is_latched("/trajectory_execution_event")
        said = [told["msg"] for told in world.heard("screen")]
        assert said == [
            f"{op}: field latch: has no effect, it needs the role operate" for op in ("advertise", "publish")
        ]

    def test_a_client_is_warned_with_the_limit_of_what_is_not_latched(
        self, world: InProcess, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(latching, "MAX_CLIENT_LATCHED_BYTES", 100)
        world.say("x", op="set_level", level="warning")
        world.say("x", op="advertise", topic="/map", type="std_msgs/String", latch=True)
        world.say("x", op="publish", topic="/map", msg={"data": "x" * 200})
        (told,) = world.heard("x")
        assert told["level"] == "warning"
        assert told["msg"] == (
            "publish: topic /map: not latched: this client has 211 bytes latched with it, the limit is 100"
        )
