import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from pydantic import SecretStr

from harness.waiting import until
from robot.stop_epochs import STOP_EPOCHS
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.arrival import arrival_epoch
from server.gateway.http import MAX_BODY_BYTES, HttpHandler
from server.gateway.http_goals import GRIPPER_ACTION, GRIPPER_TYPE, HttpGoals
from server.gateway.listener import Listener
from server.graph.actions import ActionGoal, GoalStatus
from server.graph.permissions import ANYONE, CALLED_GOAL, GOAL, STOPPING, Node
from server.graph.services import Call, Response
from server.graph.topics import Graph
from tests.helpers.gateway import REGISTRY, TIMEOUT_S, exchange, listening, until_empty

OPERATOR, VIEWER = "operator-0123456789", "viewer-0123456789ab"
READY = {"named": "ready"}
BODY = json.dumps(READY).encode()


class Arm:
    """The services and the action that goals by HTTP lead to; each request waits to be ended by its test."""

    def __init__(self, graph: Graph) -> None:
        self.node = Node("arm")
        self.calls: list[Call] = []
        self.epochs: list[int] = []
        self.ends: list[Response] = []
        self.gripper: list[ActionGoal] = []
        self.stops, self.stands = 0, asyncio.Event()
        self.stands.set()
        type_name, trigger = "armbridge_msgs/srv/MoveitGoal", "std_srvs/srv/Trigger"
        graph.services.offer_calls(self.node, "/moveit_goal", type_name, self._call, rule=CALLED_GOAL)
        graph.services.offer(self.node, "/arm/stop", trigger, self._stop, rule=STOPPING)
        graph.actions.offer(self.node, GRIPPER_ACTION, GRIPPER_TYPE, self.gripper.append, rule=GOAL)

    def _call(self, call: Call) -> None:
        self.epochs.append(arrival_epoch())
        self.calls.append(call)
        call.when_ended(self.ends.append)

    async def _stop(self, _request: object) -> str:
        self.stops += 1
        await self.stands.wait()
        return "stopped"

    async def call(self) -> Call:
        await until(lambda: bool(self.calls))
        return self.calls[-1]


class Door:
    """A listener with one way in, ``POST /goal``."""

    def __init__(self, listener: Listener, arm: Arm, access: Access) -> None:
        self.listener, self.arm, self.access = listener, arm, access

    async def open(self, body: object, *lines: str, path: str = "/goal", token: str = OPERATOR) -> asyncio.StreamReader:
        """Send a request and leave the connection open; ``self.writer`` is its other side."""
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        sent = {"Host": "localhost", "Content-Type": "application/json", "Content-Length": str(len(data))}
        sent |= {"Authorization": f"Bearer {token}"} if token else {}
        for line in lines:
            name, _, value = line.partition(": ")
            sent[name] = value
        head = "".join(f"{name}: {value}\r\n" for name, value in sent.items() if value)
        reader, self.writer = await asyncio.open_connection("127.0.0.1", self.listener.port)
        self.writer.write(f"POST {path} HTTP/1.1\r\n{head}\r\n".encode() + data)
        return reader

    async def answer(self, reader: asyncio.StreamReader) -> tuple[int, Any]:
        async with asyncio.timeout(TIMEOUT_S):
            head, _, body = (await reader.read()).partition(b"\r\n\r\n")
        self.writer.close()
        return int(head.split(b" ")[1]), json.loads(body) if b"application/json" in head else body.decode()

    async def post(self, body: object, *lines: str, path: str = "/goal", token: str = OPERATOR) -> tuple[int, Any]:
        return await self.answer(await self.open(body, *lines, path=path, token=token))


@pytest.fixture
async def door() -> AsyncIterator[Door]:
    graph = Graph(REGISTRY)
    tokens = {"operate_tokens": {"plc": SecretStr(OPERATOR)}, "view_tokens": {"screen": SecretStr(VIEWER)}}
    access = Access(AccessSettings.model_validate(tokens))
    goals = HttpGoals(graph, access, ("left",), takes_goals_along=False)
    arm = Arm(graph)
    async with listening(http=HttpHandler(post_routes={"goal": goals.answer}), graph=graph, access=access) as listener:
        yield Door(listener, arm, access)
        await until_empty(listener)


@pytest.mark.parametrize(
    ("ended", "status"),
    [
        ({"success": True, "code": 1, "code_name": "SUCCESS", "message": "the arm is there"}, 200),
        ({"code": -31, "code_name": "NO_IK_SOLUTION", "message": "out of reach"}, 422),
        ({"code": -7, "code_name": "PREEMPTED", "message": "stopped"}, 409),
        ({"code": 99999, "code_name": "FAILURE", "message": "the queue is full"}, 503),
    ],
)
async def test_a_goal_gets_the_one_answer_of_its_service(door: Door, ended: dict[str, Any], status: int) -> None:
    reader = await door.open({**READY, "velocity_scaling": 0.1})
    call = await door.arm.call()
    assert (call.request["named"], call.request["velocity_scaling"], str(call.caller)[:5]) == ("ready", 0.1, "plc (")
    call.succeed(ended)
    assert await door.answer(reader) == (status, {**door.arm.ends[0].values, "stops": STOP_EPOCHS.present})
    # As of a client that has left: the arm is free for others.
    assert door.access.lease.holder is None
    assert not door.access.drivers


async def test_a_stop_needs_no_more_than_the_right_to_look_and_stops_beside_other_fields_too(door: Door) -> None:
    stopped = {"success": True, "message": "stopped", "stops": STOP_EPOCHS.present}
    assert await door.post({"stop": True}, token=VIEWER) == (200, stopped)
    for asked in ({**READY, "stop": True}, {"stop": 1}, {"stop": "now", "speed": 3}, {"stop": True, "after_stop": -1}):
        assert await door.post(asked) == (200, stopped), asked
    assert await door.post({"stop": True}, path="/goal?timeout=soon&on_disconnect=halt") == (200, stopped)


@pytest.mark.parametrize(
    ("end", "status", "message"),
    [
        (lambda goal: goal.finish(GoalStatus.SUCCEEDED, {"reached_goal": True}), 200, "the gripper is there"),
        (lambda goal: goal.finish(GoalStatus.SUCCEEDED, {"stalled": True}), 200, "the gripper holds an object"),
        (lambda goal: goal.finish(GoalStatus.CANCELED, {}), 409, "the goal of the gripper was cancelled"),
        (lambda goal: goal.fail("the arm is relaxed"), 422, "the arm is relaxed"),
    ],
)
async def test_the_gripper_is_a_goal_of_its_own(door: Door, end: Any, status: int, message: str) -> None:
    reader = await door.open({"gripper": {"position": 0.5, "max_effort": 0.3}})
    await until(lambda: bool(door.arm.gripper))
    assert door.arm.gripper[0].request["command"] == {"position": 0.5, "max_effort": 0.3}
    end(door.arm.gripper[0])
    got, answer = await door.answer(reader)
    assert (got, answer["success"], answer["message"][: len(message)]) == (status, status == 200, message)


async def test_a_mistake_is_one_sentence_that_names_it(door: Door) -> None:
    for body, lines, status, message in (
        (b"{", (), 400, "the body is no JSON"),
        (b"", (), 400, "the body is no JSON"),
        (b'{"gripper":{"position":NaN}}', (), 400, "the body is no JSON"),
        (b"[" * 20_000, (), 400, "the body is no JSON"),
        ([1], (), 400, "the body must be a JSON object, not a list of 1"),
        ({**READY, "stop": False}, (), 422, "field stop: wanted a field of"),
        ({**READY, "after_stop": -1}, (), 400, "field after_stop: must be a whole number from 0 to"),
        (
            {"gripper": {"position": 0}, "after_stop": "now"},
            (),
            400,
            "the present value of stops in /arm/state, not 'now'",
        ),
        ({**READY, "speed": 1}, (), 422, "(named, joints, pose, group"),
        ({"gripper": 0.5}, (), 400, "field gripper: must be an object with position, by itself, not 0.5"),
        ({"gripper": {"position": 0}, **READY}, (), 400, "beside named"),
        ({"gripper": {"max_effort": 1}}, (), 400, "field gripper: must be an object with position"),
        ({"gripper": {"position": 0, "speed": 1}}, (), 422, "speed: wanted a field of"),
        ({"gripper": {"position": "wide"}}, (), 422, "command.position"),
        ({**READY, "arm": "right"}, (), 400, "field arm: 'right' is unknown; known: left"),
        ({**READY, "velocity_scaling": "fast"}, (), 422, "velocity_scaling"),
        ({"joints": {"name": ["a"] * 40_000}}, (), 413, f"the limit is {MAX_BODY_BYTES}"),
        (READY, ("Content-Type: text/plain",), 415, "must be application/json, not text/plain"),
        (READY, ("Content-Type: ",), 415, "must be application/json, not none"),
        (READY, ("Content-Length: ",), 411, "Content-Length must be one number, without Transfer-Encoding, not none"),
        (READY, ("Content-Length: -1",), 400, "without Transfer-Encoding, not -1"),
        (READY, ("Transfer-Encoding: chunked",), 411, "without Transfer-Encoding, not "),
    ):
        got, answer = await door.post(body, *lines)
        assert (got, answer["success"]) == (status, False)
        assert message in answer["message"]
        assert not door.arm.calls, message
        assert not door.arm.gripper, message
    got, answer = await door.post(READY, path="/goal?on_disconnect=halt")
    assert (got, answer["message"]) == (400, "?on_disconnect= must be finish or stop, not 'halt'")
    assert not door.arm.calls


async def test_the_deadline_is_within_its_limits_and_a_goal_that_outlasts_it_is_cancelled(door: Door) -> None:
    for text in ("0", "-1", "nan", "3601", "soon"):
        got, answer = await door.post(READY, path=f"/goal?timeout={text}")
        assert (got, answer["message"]) == (400, f"timeout must be above 0 and at most 3600 s, not {text!r}")
    got, answer = await door.post(READY, path="/goal?timeout=0.01")
    assert (got, answer["message"]) == (504, "the goal did not end within 0.01 s (?timeout=), so it is cancelled")
    call = await door.arm.call()
    assert (call.ended, call.caller_left, call.caller.takes_goals_along) == (True, True, True)


async def test_who_may_not_and_a_page_of_another_site_get_the_reason_and_move_nothing(door: Door) -> None:
    for origin in ("https://evil.example", "null"):
        got, answer = await door.post(READY, f"Origin: {origin}")
        assert (got, "may not connect" in answer) == (403, True)
    assert not door.arm.calls
    got, answer = await door.post(READY, token=VIEWER)
    assert (got, "needs the role propose, this client has view" in answer["message"]) == (403, True)
    assert (await door.post(READY, token=""))[0] == 401
    assert (await door.post(READY, token="nobody-0123456789"))[0] == 401
    door.access.lease.drive(Node("alice", remote=True, identity=ANYONE), door.access.clock())
    got, answer = await door.post(READY)
    assert (got, "alice has controlled the arm" in answer["message"]) == (409, True)
    assert not door.arm.calls


async def test_other_methods_are_refused(door: Door) -> None:
    head = f"Host: localhost\r\nAuthorization: Bearer {OPERATOR}\r\n\r\n"
    for line, allowed in {
        "GET /goal": "POST",
        "OPTIONS /goal": "POST",
        "PUT /goal": "POST",
        "POST /": "GET, HEAD",
    }.items():
        answer = await exchange(door.listener.port, f"{line} HTTP/1.1\r\n{head}".encode())
        assert answer.startswith("HTTP/1.1 405 "), line
        assert f"Allow: {allowed}\r\n" in answer, line


@pytest.mark.parametrize("asked", ["", "?on_disconnect=stop"])
@pytest.mark.parametrize("broken", [False, True])
async def test_a_leaving_clients_goal_goes_on_or_stops_as_over_websocket(door: Door, asked: str, broken: bool) -> None:
    await door.open(READY, path=f"/goal{asked}")
    call = await door.arm.call()
    (door.writer.transport.abort if broken else door.writer.close)()
    await until(lambda: bool(door.arm.ends))
    # The service cancels the motion of such a call, and lets any other go on.
    assert (call.caller_left, call.caller.takes_goals_along) == (True, bool(asked))
    assert door.access.lease.holder is None


@pytest.fixture
async def continued(door: Door) -> asyncio.StreamReader:
    """The answers to a request for READY whose body the server waits for."""
    reader = await door.open(b"", f"Content-Length: {len(BODY)}", "Expect: 100-continue")
    async with asyncio.timeout(TIMEOUT_S):
        assert await reader.readuntil(b"\r\n\r\n") == b"HTTP/1.1 100 Continue\r\n\r\n"
    return reader


async def test_a_body_comes_in_pieces_and_with_more_behind_it(door: Door, continued: asyncio.StreamReader) -> None:
    for octet in BODY:
        door.writer.write(bytes([octet]))
        await door.writer.drain()
        await asyncio.sleep(0)
    door.writer.write(b"GET / HTTP/1.1\r\n\r\n")
    (await door.arm.call()).succeed({"success": True})
    assert (await door.answer(continued))[0] == 200


async def test_a_body_that_does_not_come_is_not_waited_for(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.gateway.websocket.REQUEST_TIMEOUT_S", 0.05)
    got, answer = await door.post(READY, "Content-Length: 1000")
    assert (got, answer) == (400, "the request was not complete within 0.05 s\n")
    reader = await door.open(READY, "Content-Length: 1000")
    door.writer.write_eof()
    assert (await door.answer(reader))[0] == 400


async def test_a_stop_while_the_body_comes_is_later_than_the_goal(door: Door, continued: asyncio.StreamReader) -> None:
    before = STOP_EPOCHS.present
    STOP_EPOCHS.begin()
    door.writer.write(BODY)
    (await door.arm.call()).succeed({})
    assert door.arm.epochs == [before]
    # Nor is it known to who reads the answer, and names it with the next goal.
    assert (await door.answer(continued))[1]["stops"] == before


async def test_a_goal_is_as_old_as_the_stop_that_it_names(door: Door) -> None:
    seen = STOP_EPOCHS.begin()
    STOP_EPOCHS.begin()
    reader = await door.open({**READY, "after_stop": seen})
    (await door.arm.call()).succeed({"success": True})
    await door.answer(reader)
    assert door.arm.epochs == [seen]


async def test_the_answer_to_a_stop_names_no_later_stop(door: Door) -> None:
    door.arm.stands.clear()
    reader = await door.open({"stop": True})
    await until(lambda: door.arm.stops == 1)
    before = STOP_EPOCHS.present
    STOP_EPOCHS.begin()
    door.arm.stands.set()
    assert (await door.answer(reader))[1]["stops"] == before
