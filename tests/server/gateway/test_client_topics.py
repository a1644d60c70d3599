import json

import pytest

from protocol.codecs import png
from protocol.errors import FrameError
from protocol.limits import Limits
from protocol.session import Session
from server.gateway.client import Client
from server.graph import latching
from server.graph.permissions import Identity, Node, Role
from server.graph.topics import UNREGISTER_TIMEOUT_S, Graph, Subscriber
from tests.helpers.gateway import InProcess


@pytest.fixture
def world() -> InProcess:
    return InProcess(Limits.model_construct(max_subscriptions=2, max_publications=2))


@pytest.mark.parametrize("op", ["subscribe", "advertise"])
def test_operations_over_the_limit_do_nothing(world: InProcess, op: str, caplog: pytest.LogCaptureFixture) -> None:
    for topic in ("/a", "/b", "/c"):
        world.say("x", op=op, topic=topic, type="std_msgs/String")
    assert list(world.graph.topic_names.types()) == ["/a", "/b"]
    assert "limit is 2" in caplog.text


def test_an_operation_at_the_limit_keeps_what_the_client_has_on_that_topic(world: InProcess) -> None:
    for mark in ("1", "2", "3"):
        world.say("x", op="subscribe", topic="/a", type="std_msgs/String", id=mark)
    world.say("y", op="publish", topic="/a", msg={"data": "hello"})
    assert len(world.heard("x")) == 1


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


class TestMisspeltTopics:
    """What a client is told of a topic whose name is nearly that of one of the server's."""

    @pytest.fixture(autouse=True)
    def _server(self, world: InProcess) -> None:
        world.graph.subscribe(Node("server"), "/moveit_goal_named", "std_msgs/String", Subscriber(lambda _: None))
        world.say("other", op="advertise", topic="/moveit_goal_nome", type="std_msgs/String")

    def test_a_message_is_refused_with_the_topic_that_was_meant(self, world: InProcess) -> None:
        world.say("x", op="publish", topic="/moveit_goal_nmaed", msg={"data": "ready"})
        (told,) = world.heard("x")
        assert (told["op"], told["level"]) == ("status", "error")
        assert told["msg"].endswith("; did you mean /moveit_goal_named?")

    @pytest.mark.parametrize("op", ["advertise", "subscribe"])
    def test_a_registration_is_carried_out_with_a_warning(self, world: InProcess, op: str) -> None:
        world.say("x", op=op, topic="/moveit_goal_name", type="std_msgs/String")
        (told,) = world.heard("x")
        assert (told["op"], told["level"]) == ("status", "warning")
        assert told["msg"] == f"{op}: topic /moveit_goal_name: nobody else uses it; did you mean /moveit_goal_named?"

    def test_a_misspelt_stop_is_answered_whatever_was_carried_out_before(self, world: InProcess) -> None:
        world.say("x", op="advertise", topic="/estop", type="std_msgs/Empty")
        estop, upper = {"op": "publish", "topic": "/estop", "msg": {}}, {"op": "publish", "topic": "/Stop"}
        for stop in (estop, estop, upper, {"op": "stop"}):
            world.say("x", **stop)
        *topics, unknown = (each["msg"] for each in world.heard("x"))
        sentence = "publish: topic {}: nobody reads it, so nothing was stopped; /stop stops the arm"
        assert topics == [sentence.format(topic) for topic in ("/estop", "/estop", "/Stop")]
        assert unknown.startswith("field op: wanted one of ")
        world.graph.subscribe(Node("server"), "/estop", "std_msgs/Empty", Subscriber(lambda _: None))
        world.say("x", op="publish", topic="/estop")
        assert world.heard("x") == []

    def test_a_viewer_that_misspells_a_stop_is_answered_too(self, world: InProcess) -> None:
        world.enter("screen", Identity("screen", Role.VIEW))
        world.say("screen", op="publish", topic="/estop", msg={})
        assert [each["level"] for each in world.heard("screen")] == ["error"]

    def test_clients_without_warnings_cost_nothing(self, world: InProcess, monkeypatch: pytest.MonkeyPatch) -> None:
        world.say("x", op="advertise", topic="/chat", type="std_msgs/String")
        compared: list[str] = []
        monkeypatch.setattr(world.graph, "topic_hint", compared.append)
        world.say("x", op="subscribe", topic="/moveit_goal_name", type="std_msgs/String")
        assert compared == []

    def test_other_topics_pass_without_a_word(self, world: InProcess) -> None:
        for topic in ("/moveit_goal_named", "/chat", "/moveit_goal_nome", f"/{'x' * 200}"):
            world.say(topic, op="subscribe", topic=topic, type="std_msgs/String")
            assert world.heard(topic) == []


def test_a_remark_on_a_topic_reaches_clients_that_publish_there_already(world: InProcess) -> None:
    world.say("x", op="set_level", level="warning")
    publish = {"op": "publish", "topic": "/a", "msg": {"data": "text"}}
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    world.say("x", **publish)
    world.graph.remark({"/a": "topic /a stays here"})
    world.say("x", **publish)
    world.graph.remark({})
    world.say("x", **publish)
    assert [each["msg"] for each in world.heard("x")] == ["publish: topic /a stays here"]


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

    def test_a_client_is_warned_of_what_is_not_latched(self, world: InProcess, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(latching, "MAX_CLIENT_LATCHED_BYTES", 100)
        world.say("x", op="set_level", level="warning")
        world.say("x", op="advertise", topic="/map", type="std_msgs/String", latch=True)
        world.say("x", op="publish", topic="/map", msg={"data": "x" * 200})
        (told,) = world.heard("x")
        assert told["level"] == "warning"
        assert told["msg"] == (
            "publish: topic /map: not latched: this client has 211 bytes latched with it, the limit is 100"
        )


STRING = {"topic": "/a", "type": "std_msgs/String"}


FRAME = json.dumps({"op": "publish", "topic": "/a", "msg": {"data": "text"}})


@pytest.fixture
def publisher(world: InProcess) -> Client:
    """The client y, which has published on a topic to which x has subscribed."""
    world.say("x", op="subscribe", **STRING)
    client = world.client("y")
    client.receive_frame(FRAME)
    assert len(world.heard("x")) == 1
    return client


class TestStrictWay:
    """Messages on a topic on which the client has published before, without anything forgiven."""

    def test_they_are_published_the_strict_way(self, world: InProcess, monkeypatch: pytest.MonkeyPatch) -> None:
        world.say("x", op="subscribe", **STRING)
        world.say("y", op="publish", topic="/a", msg={"data": "0"})
        monkeypatch.setattr(Graph, "publish", None)
        for text in ("1", "2"):
            world.say("y", op="publish", topic="/a", msg={"data": text})
        assert [said["msg"] for said in world.heard("x")] == [{"data": text} for text in "012"]

    def test_a_message_that_takes_the_general_way_is_followed_by_strict_ones(self, world: InProcess) -> None:
        world.say("x", op="subscribe", topic="/a", type="geometry_msgs/Point")
        for message in ({"x": 1.0, "y": 2.0, "z": 3.0}, {"x": 1}, {"x": 4.0, "y": 5, "z": 6.0}, {"w": 1}, {"y": 7}):
            world.say("y", op="publish", topic="/a", msg=message)
        heard = [tuple(said["msg"].values()) for said in world.heard("x")]
        assert heard == [(1, 2, 3), (1, 0, 0), (4, 5, 6), (0, 7, 0)]

    @pytest.mark.parametrize("change", ["type", "role", "latch"])
    def test_after_a_change_frames_take_the_general_way(self, world: InProcess, publisher: Client, change: str) -> None:
        if change == "type":
            world.say("x", op="unsubscribe", topic="/a")
            publisher.leave()
            world.clock.advance(UNREGISTER_TIMEOUT_S + 1.0)
            world.say("x", op="subscribe", topic="/a", type="std_msgs/Int32")
        elif change == "role":
            publisher.node.identity = Identity("y", Role.VIEW)
            publisher._authorizer.authenticate(publisher.node.identity)
        else:
            world.say("y", op="advertise", latch=True, **STRING)
        assert not publisher.publish_strictly(FRAME)
        assert world.heard("x") == []

    def test_a_change_of_the_graph_elsewhere_ends_nothing(self, world: InProcess, publisher: Client) -> None:
        world.say("z", op="subscribe", **STRING)
        world.heard("z")
        assert publisher.publish_strictly(FRAME)
        assert [said["msg"] for said in world.heard("z")] == [{"data": "text"}]

    def test_a_subscriber_that_came_too_late_gets_it_in_its_own_encoding(self, world: InProcess) -> None:
        world.say("y", op="advertise", topic="/a", type="std_msgs/Int32")
        for _ in range(2):
            world.say("y", op="publish", topic="/a", msg={"data": 7})
        world.say("x", op="subscribe", topic="/a", type="std_msgs/Int32", compression="png")
        packed = [json.loads(png.decode(said["data"])) for said in world.heard("x")]
        assert [each["msg"] for each in packed] == [{"data": 7}] * 2

    def test_a_whole_message_behind_a_piece_of_another_ends_that(self, world: InProcess, publisher: Client) -> None:
        for frame in (FRAME[:20], FRAME, FRAME[20:]):
            publisher.receive_frame(frame)
        assert len(world.heard("x")) == 1

    def test_what_is_called_topic_elsewhere_is_not_taken_for_the_operations(self, world: InProcess) -> None:
        for topic in ("/a", "/b"):
            world.say("x", op="subscribe", topic=topic, type="diagnostic_msgs/KeyValue")
            world.say("y", op="publish", topic=topic, msg={"key": "", "value": ""})
        world.heard("x")
        frame = '{"topic": "/b", "msg": {"key": "", "value": ""}, "op": "publish", "topic": "/a"}'
        world.client("y").receive_frame(frame)
        assert [said["topic"] for said in world.heard("x")] == ["/a"]
