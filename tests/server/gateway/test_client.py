import json
import logging
import math
from typing import Any

import bson
import pytest

from protocol.codecs import png
from protocol.limits import Limits
from protocol.operations import Auth
from protocol.session import Refusal
from robot.stop_epochs import STOP_EPOCHS
from server.access.settings import AccessSettings
from server.arrival import arrival_epoch
from server.errors import UnsuccessfulError
from server.gateway.client_context import MAX_UNASKED_ERRORS
from server.graph.permissions import STOPPING, Identity, Node, Role
from server.graph.topics import Subscriber
from tests.helpers.gateway import InProcess


@pytest.fixture
def world() -> InProcess:
    return InProcess()


def test_a_bug_in_one_operation_does_not_take_the_client_with_it(
    world: InProcess, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world.graph, "advertise", lambda *_, **__: 1 / 0)
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    assert "x: advertise failed" in caplog.text
    world.say("x", op="subscribe", topic="/b", type="std_msgs/String")
    assert "/b" in world.graph.topic_names.types()


async def test_messages_that_were_dropped_are_told_when_the_client_leaves(caplog: pytest.LogCaptureFixture) -> None:
    world = InProcess(Limits.model_construct(max_queued_bytes=1000))
    slow = world.client("slow")
    slow.receive_frame('{"op":"subscribe","topic":"/t","type":"std_msgs/String"}')
    talker = world.client("talker")
    for _ in range(10):
        talker.receive_frame('{"op":"publish","topic":"/t","msg":{"data":"%s"}}' % ("x" * 200))
    await world.close("slow")
    assert f"slow: {slow.session.dropped} messages were dropped" in caplog.text
    assert slow.session.dropped > 0


def test_a_service_without_a_field_for_the_reason_of_its_failure_tells_it_by_a_status() -> None:
    def serve(_request: dict[str, Any]) -> dict[str, Any]:
        raise UnsuccessfulError({"success": False}, "the disk is full")

    world = InProcess()
    world.graph.services.offer(Node("server"), "/save", "moveit_msgs/srv/SaveGeometryToFile", serve)
    world.say("ui", op="set_level", level="error")
    world.say("ui", op="call_service", service="/save", id="s1")
    status, response = world.heard("ui")
    sentence = "call_service: service /save: the disk is full"
    assert status == {"op": "status", "level": "error", "msg": sentence, "id": "s1"}
    assert (response["values"], response["result"]) == ({"success": False}, True)


class TestAfterStop:
    """Requests that name the last stop that their client knew of."""

    @pytest.fixture
    def epochs(self, world: InProcess) -> list[int]:
        """Stop epochs of the requests that were carried out."""
        server, epochs = Node("server"), list[int]()

        def take(_request: object) -> dict[str, Any]:
            epochs.append(arrival_epoch())
            return {}

        world.graph.services.offer(server, "/move", "std_srvs/srv/Trigger", take)
        world.graph.services.offer(server, "/halt", "std_srvs/srv/Trigger", take, rule=STOPPING)
        world.graph.subscribe(server, "/goal", "std_msgs/String", Subscriber(take))
        world.graph.actions.offer(server, "/act", "control_msgs/action/PointHead", take)
        return epochs

    @pytest.mark.parametrize("number", [int, float])
    def test_a_request_is_as_old_as_the_stop_that_it_names(
        self, world: InProcess, epochs: list[int], number: Any
    ) -> None:
        requests: tuple[dict[str, Any], ...] = (
            {"op": "call_service", "service": "/move"},
            {"op": "publish", "topic": "/goal", "msg": {"data": "go"}},
            # Published the quick way where no stop is named.
            {"op": "publish", "topic": "/goal", "msg": {"data": "go"}},
            {"op": "send_action_goal", "action": "/act", "action_type": "control_msgs/PointHead"},
        )
        for request in requests:
            seen, later = STOP_EPOCHS.begin(), STOP_EPOCHS.begin()
            for named in (number(seen), number(later), None):
                world.say("x", **request, after_stop=named)
            world.say("x", **request)
            assert epochs[-4:] == [seen, later, later, later], request

    def test_a_number_that_the_server_has_not_made_is_refused_with_its_limits(
        self, world: InProcess, epochs: list[int]
    ) -> None:
        present = STOP_EPOCHS.begin()
        limits = (
            f"field after_stop: must be a whole number from 0 to {present}, the present value of stops in /arm/state"
        )
        numbers = (-1, present + 1, 10**30, 0.5, math.nan, math.inf, True, False, "7", [present], {})
        for number in numbers:
            world.say("x", op="call_service", service="/move", after_stop=number)
            response = world.heard("x")[-1]
            assert (response["op"], response["result"]) == ("service_response", False), number
            assert response["values"].startswith(f"{limits}, not "), number
            world.say("x", op="publish", topic="/goal", msg={"data": "go"}, after_stop=number)
        assert response["values"] == f"{limits}, not an object of 0 fields"
        assert not epochs
        # A stop needs none, so that nothing is wrong with any.
        for number in numbers:
            world.say("x", op="call_service", service="/halt", after_stop=number)
        assert epochs == [present] * len(numbers)


class TestRefused:
    """Operations of a client that may only look; who waits for an answer gets one."""

    @pytest.fixture
    def guarded(self) -> InProcess:
        world = InProcess(access=AccessSettings())
        world.enter("screen", Identity("screen", Role.VIEW))
        world.say("screen", op="set_level", level="error")
        return world

    def test_a_call_gets_a_response_and_a_goal_a_result(self, guarded: InProcess) -> None:
        guarded.say("screen", op="call_service", service="arm/enable#7")
        status, response = guarded.heard("screen")
        assert (status["op"], status["level"]) == ("status", "error")
        assert (response["op"], response["service"], response["id"]) == ("service_response", "arm/enable#7", "7")
        assert response["result"] is False
        assert response["values"].startswith("service /arm/enable: needs the role operate, this client has view")
        guarded.say("screen", op="send_action_goal", action="/a", action_type="control_msgs/PointHead", id="g")
        _, result = guarded.heard("screen")
        assert (result["op"], result["id"], result["status"], result["result"]) == ("action_result", "g", 0, False)
        assert "needs the role operate" in result["values"]

    def test_a_message_gets_a_status_and_reaches_nobody(self, guarded: InProcess) -> None:
        guarded.say("other", op="subscribe", topic="/a", type="std_msgs/String")
        guarded.say("screen", op="publish", topic="/a", msg={"data": "x"}, id="p")
        (status,) = guarded.heard("screen")
        assert status["msg"].startswith("publish: topic /a: needs the role operate")
        assert status["id"] == "p"
        assert guarded.heard("other") == []

    def test_a_goal_on_a_topic_gets_the_answer_that_the_topic_promises(self, guarded: InProcess) -> None:
        on_unauthorized: list[Any] = []
        promising = Subscriber(lambda _: None, on_unauthorized=lambda *told: on_unauthorized.append(told))
        guarded.graph.subscribe(Node("moveit"), "/moveit_goal_joints", "sensor_msgs/JointState", promising)
        stamp = {"secs": 5, "nsecs": 6}
        guarded.client("screen").session.dialect = "ros1"
        guarded.say("screen", op="publish", topic="moveit_goal_joints", msg={"header": {"stamp": stamp}})
        ((message, sender, _),) = on_unauthorized
        assert message["header"]["stamp"] == {"sec": 5, "nanosec": 6}
        assert sender is guarded.client("screen").node

    def test_packing_an_operation_gets_it_nowhere(self, guarded: InProcess) -> None:
        inside = json.dumps({"op": "advertise", "topic": "/a", "type": "std_msgs/String"})
        picture = json.dumps({"op": "png", "data": png.encode(inside.encode())})
        first, second = (
            json.dumps({"op": "fragment", "id": "f", "num": number, "total": 2, "data": data})
            for number, data in enumerate((inside[:10], inside[10:]))
        )
        several = '{"op":"subscribe","topic":"/b","type":"std_msgs/String"}' + inside
        for frames in ((picture,), (first, second), (several,)):
            for frame in frames:
                guarded.client("screen").receive_frame(frame)
            assert "/a" not in guarded.graph.topic_names.types(), frames
            assert "needs the role operate" in guarded.heard("screen")[-1]["msg"], frames

    def test_the_log_hears_of_the_same_refusal_once(self, guarded: InProcess, caplog: pytest.LogCaptureFixture) -> None:
        for _ in range(5):
            guarded.say("screen", op="publish", topic="/servo_node/delta_twist_cmds")
        assert caplog.text.count("screen: refused: publish: topic /servo_node/delta_twist_cmds") == 1
        assert len(guarded.heard("screen")) == 5


NO_JSON = Refusal(None, None, "no JSON")


def test_a_clients_status_is_logged_at_its_level_in_short(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    for level in ("error", "warning", "info"):
        world.say("x", op="status", level=level, msg="y" * 10_000)
        assert caplog.records[-1].levelname == level.upper()
        assert caplog.records[-1].getMessage().startswith("x says: yyy")
        assert len(caplog.records[-1].getMessage()) < 200
    assert len(caplog.records) == 3


def test_no_client_writes_lines_of_its_own_into_the_log(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    world.say("x", op="set_level", level="error")
    world.client("x").status.refuse(Refusal("publish", None, "publish: topic /a\nERROR all is lost\x1b[2J: no"))
    world.say("x", op="status", level="error", msg="a\r\nb")
    assert [len(record.getMessage().splitlines()) for record in caplog.records] == [1, 1]
    assert world.heard("x")[0]["msg"] == r"publish: topic /a\nERROR all is lost\x1b[2J: no"


def test_a_client_that_never_sends_anything_valid_but_a_token_gets_some_errors_only(world: InProcess) -> None:
    status = world.client("x").status
    status.acknowledge(Auth(token="t" * 16))
    status.refuse(NO_JSON)
    assert len(world.heard("x")) == 1
    for _ in range(2 * MAX_UNASKED_ERRORS):
        world.client("y").status.refuse(NO_JSON)
    assert len(world.heard("y")) == MAX_UNASKED_ERRORS


async def test_replies_to_a_client_that_speaks_bson_have_octets(world: InProcess) -> None:
    world.graph.services.offer(Node("s"), "/fetch", "file_server/GetBinaryFile", lambda _: {"value": "AQI="})
    await world.send("x", bson.encode({"op": "call_service", "service": "/fetch"}))
    frame = await world.next_frame("x")
    assert isinstance(frame, bytes)
    assert bson.decode(frame)["values"]["value"] == b"\x01\x02"
