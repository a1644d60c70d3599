"""Actions between this server and a machine that sends, and serves, the frames of rcl_action over rmw_zenoh."""

import asyncio
import threading
import uuid
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import get_types_from_msg

from harness.waiting import TIMEOUT_S, until
from protocol.type_descriptions import message_hash, service_hash
from robot.stop_epochs import STOP_EPOCHS
from server.access.settings import AccessSettings
from server.arrival import arrival_epoch
from server.graph.actions import ActionGoal, GoalStatus, Result
from server.graph.permissions import GOAL
from server.graph.topics import Subscriber
from server.zenoh import bridge, network, services, topics
from tests.helpers.zenoh_network import REGISTRY, STORE, RosMachine, Site, attached, networked

GRIPPER, GRIP = "control_msgs/action/GripperCommand", "/grip"
SUCCEEDED, CANCELED, UNKNOWN = 4, 5, 0

# What rosidl derives from an action, under names that rosbags takes.
RESULT = "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal"
FRAMES = {
    "SendGoalRequest": "uint8[16] goal_id\nfloat64 position\nfloat64 max_effort",
    "SendGoalResponse": "bool accepted\nbuiltin_interfaces/Time stamp",
    "GetResultRequest": "uint8[16] goal_id",
    "GetResultResponse": f"int8 status\n{RESULT}",
    "FeedbackMessage": f"uint8[16] goal_id\n{RESULT}",
    "CancelGoalRequest": "uint8[16] goal_id\nbuiltin_interfaces/Time stamp",
}
for frame_name, definition in FRAMES.items():
    STORE.register(get_types_from_msg(definition, f"test_msgs/msg/{frame_name}"))

SERVICES = {
    "send_goal": f"{GRIPPER}_SendGoal",
    "get_result": f"{GRIPPER}_GetResult",
    "cancel_goal": "action_msgs/srv/CancelGoal",
}


def written(frame: str, **fields: Any) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[f"test_msgs/msg/{frame}"](**fields), f"test_msgs/msg/{frame}"))


def read(frame: str, octets: bytes) -> Any:
    return STORE.deserialize_cdr(octets, f"test_msgs/msg/{frame}")


def dds(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    type_hash = (message_hash if name.endswith("FeedbackMessage") else service_hash)(REGISTRY, type_name)
    return f"{package}::{kind}::dds_::{name}_/{type_hash}"


def key(part: str) -> str:
    return f"0{GRIP}/_action/{part}/{dds(SERVICES.get(part, f'{GRIPPER}_FeedbackMessage'))}"


def offered(site: Site) -> list[ActionGoal]:
    """Goals of an action that a part of the server offers, which it leaves to the test."""
    goals: list[ActionGoal] = []
    site.graph.actions.offer(site.part, GRIP, GRIPPER, goals.append, rule=GOAL)
    return goals


class ActionClient:
    """Client of an action on the ROS 2 machine."""

    def __init__(self, machine: RosMachine) -> None:
        self.machine = machine
        self.goal_id = np.frombuffer(uuid.uuid4().bytes, np.uint8)

    async def call(self, part: str, payload: bytes) -> bytes:
        await until(lambda: self.machine.has_token(f"/SS/%/%/armbridge/%grip%_action%{part}/"))
        (reply,) = await asyncio.to_thread(self.machine.call, "", payload, key(part))
        assert reply.ok is not None, reply.err and bytes(reply.err.payload)
        return bytes(reply.ok.payload)

    async def send(self, position: float = 0.5) -> bool:
        """Send the goal; return True if it is accepted."""
        frame = written("SendGoalRequest", goal_id=self.goal_id, position=position, max_effort=0.0)
        return bool(read("SendGoalResponse", await self.call("send_goal", frame)).accepted)

    async def result(self) -> Any:
        return read("GetResultResponse", await self.call("get_result", self._written("GetResultRequest")))

    async def cancel(self) -> None:
        stamp = STORE.types["builtin_interfaces/msg/Time"](0, 0)
        await self.call("cancel_goal", self._written("CancelGoalRequest", stamp=stamp))

    def _written(self, frame: str, **fields: Any) -> bytes:
        return written(frame, goal_id=self.goal_id, **fields)


async def test_a_ros_2_machine_sends_a_goal_hears_of_it_until_its_result_and_cancels_another() -> None:
    async with networked(offer=(GRIP,)) as (site, machine):
        goals, client = offered(site), ActionClient(machine)
        statuses = machine.hear(f"{GRIP}/_action/status", "action_msgs/msg/GoalStatusArray")
        feedback: list[bytes] = []
        machine.session.declare_subscriber(key("feedback"), lambda sample: feedback.append(bytes(sample.payload)))
        for token in (f"feedback/{dds(GRIPPER + '_FeedbackMessage')}", "status/action_msgs::msg::dds_::"):
            await until(lambda token=token: machine.has_token(f"/MP/%/%/armbridge/%grip%_action%{token}"))
        assert await client.send(0.5)
        assert goals[0].request["command"]["position"] == 0.5
        goals[0].feedback({"position": 0.25})
        await until(lambda: feedback)
        asking = asyncio.create_task(client.result())
        await until(lambda: site.bridge._sharing is not None and statuses)
        goals[0].finish(GoalStatus.SUCCEEDED, {"position": 0.5, "reached_goal": True})
        result = await asking
        assert (result.status, result.position, result.reached_goal) == (SUCCEEDED, 0.5, True)
        # Who asks late gets it too.
        assert (await client.result()).status == SUCCEEDED
        await until(lambda: statuses[-1][0].status_list[-1].status == SUCCEEDED)
        status = statuses[-1][0].status_list[-1]
        # Another goal is cancelled by the id that the machine chose.
        other = ActionClient(machine)
        assert await other.send()
        goals[1].when_canceled(lambda: goals[1].finish(GoalStatus.CANCELED, {}))
        await other.cancel()
        assert (await other.result()).status == CANCELED
    told = read("FeedbackMessage", feedback[0])
    assert (told.position, bytes(told.goal_id)) == (0.25, bytes(client.goal_id))
    assert bytes(status.goal_info.goal_id.uuid) == bytes(client.goal_id)


async def test_an_action_that_fits_no_pattern_takes_no_goals() -> None:
    async with networked(offer=("/arm/*",)) as (site, machine):
        offered(site)
        site.graph.services.offer(site.part, "/arm/enable", "std_srvs/srv/Trigger", lambda _request: {})
        await until(lambda: machine.has_token("%arm%enable"))
        # A goal that moves nothing any more is no harm.
        await until(lambda: machine.has_token("%grip%_action%cancel_goal"))
        assert not machine.has_token("%grip%_action%send_goal")
        assert not machine.has_token("%grip%_action%status")


async def test_a_goal_that_is_not_taken_on_is_rejected_and_the_log_says_why(caplog: pytest.LogCaptureFixture) -> None:
    async with networked(offer=(GRIP,)) as (site, machine):
        goals, client = offered(site), ActionClient(machine)
        assert await client.send()
        assert not await client.send()
        unreadable = await ActionClient(machine).call("send_goal", b"\0\1\0\0")
        assert not read("SendGoalResponse", unreadable).accepted
        assert (await ActionClient(machine).result()).status == UNKNOWN
        goals[0].fail("the gripper is lost")
        assert (await client.result()).status == GoalStatus.ABORTED
    assert len(goals) == 1
    assert "a goal of another machine to /grip is rejected: another goal has its id" in caplog.text


async def test_goals_of_other_machines_need_their_role_and_control_of_the_arm(caplog: pytest.LogCaptureFixture) -> None:
    async with networked(offer=(GRIP,), role="view") as (site, machine):
        goals = offered(site)
        assert not await ActionClient(machine).send()
    async with networked(offer=(GRIP,), access=AccessSettings(control="lease")) as (site, machine):
        goals += offered(site)
        site.access.lease.drive(site.client, asyncio.get_running_loop().time())
        assert not await ActionClient(machine).send()
    assert goals == []
    assert "action /grip: needs the role operate" in caplog.text
    assert "client has controlled the arm since" in caplog.text


async def test_a_client_with_another_version_of_the_action_is_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    other = f"control_msgs::action::dds_::GripperCommand_SendGoal_/RIHS01_{'0' * 64}"
    async with networked(offer=(GRIP,)) as (site, machine):
        offered(site)
        machine.announce("SC", f"{GRIP}/_action/get_result", dds(SERVICES["get_result"]))
        machine.announce("SC", f"{GRIP}/_action/send_goal", other)
        await until(lambda: "another version" in caplog.text)
    assert caplog.text.count("another version") == 1
    assert "/grip/_action/send_goal of another machine has another version of control_msgs/action/" in caplog.text


async def test_results_are_kept_for_a_while_and_in_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "MAX_GOALS", 1)
    monkeypatch.setattr(services, "ENDED_KEPT_S", 0.0)
    async with networked(offer=(GRIP,)) as (site, machine):
        goals, client = offered(site), ActionClient(machine)
        assert await client.send()
        assert not await ActionClient(machine).send()
        goals[0].finish(GoalStatus.SUCCEEDED, {})
        assert (await client.result()).status in (SUCCEEDED, UNKNOWN)
        assert (await client.result()).status == UNKNOWN
        assert await ActionClient(machine).send()


async def test_a_stop_that_comes_while_a_goal_is_decoded_is_not_overtaken(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (network, topics):
        monkeypatch.setattr(module, "BYTES_AT_ONCE", 0)
    topic, epochs, go_on = "/moveit_goal_named", list[int](), threading.Event()

    def note(_asked: object) -> dict[str, Any]:
        epochs.append(arrival_epoch())
        return {}

    async with networked(offer=(GRIP, "/moveit_goal"), subscribe=(topic,)) as (site, machine):
        site.graph.subscribe(site.part, topic, "std_msgs/msg/String", Subscriber(note))
        site.graph.actions.offer(site.part, GRIP, GRIPPER, note, rule=GOAL)
        site.graph.services.offer(site.part, "/moveit_goal", "std_srvs/srv/Trigger", note)
        assert site.bridge._sharing is not None
        threads = site.bridge._threads
        for _ in range(bridge.DECODING_THREADS):
            threads.submit(go_on.wait, TIMEOUT_S)
        sending = asyncio.create_task(ActionClient(machine).send())
        await until(lambda: machine.has_token("%moveit_goal/") and machine.has_token("/armbridge/%moveit_goal_named/"))
        calling = asyncio.create_task(asyncio.to_thread(machine.call, "/moveit_goal"))
        machine.publish(topic, "std_msgs/msg/String", data="ready")
        await until(lambda: threads._work_queue.qsize() == 3)
        arrived = STOP_EPOCHS.present
        STOP_EPOCHS.begin()
        go_on.set()
        await asyncio.gather(sending, calling)
        await until(lambda: len(epochs) == 3)
    assert epochs == [arrived] * 3


class ActionServer:
    """Action on the ROS 2 machine; goals stay unanswered until they are ended."""

    def __init__(self, machine: RosMachine, *, accepts: bool = True) -> None:
        self.requests: list[Any] = []
        self.cancelled: list[bytes] = []
        self._machine, self._accepts = machine, accepts
        self._waiting: list[zenoh.Query] = []
        serving = {
            "send_goal": self._send_goal,
            "get_result": self._waiting.append,
            "cancel_goal": lambda query: self.cancelled.append(bytes(query.payload or b"")[4:20]),
        }
        for part, serve in serving.items():
            machine.session.declare_queryable(key(part), serve, complete=True)
            machine.announce("SS", f"{GRIP}/_action/{part}", dds(SERVICES[part]))

    def _send_goal(self, query: zenoh.Query) -> None:
        self.requests.append(read("SendGoalRequest", bytes(query.payload or b"")))
        stamp = STORE.types["builtin_interfaces/msg/Time"](0, 0)
        answer = written("SendGoalResponse", accepted=self._accepts, stamp=stamp)
        query.reply(key("send_goal"), answer, attachment=query.attachment)

    def feedback(self, position: float) -> None:
        values = {"position": position, "effort": 0.0, "stalled": False, "reached_goal": False}
        frame = written("FeedbackMessage", goal_id=self.requests[-1].goal_id, **values)
        self._machine.session.put(key("feedback"), frame, attachment=attached(1))

    async def end(self, status: int, position: float) -> None:
        await until(lambda: self._waiting)
        query = self._waiting.pop()
        values = {"position": position, "effort": 0.0, "stalled": False, "reached_goal": True}
        frame = written("GetResultResponse", status=status, **values)
        query.reply(key("get_result"), frame, attachment=query.attachment)
        query.drop()


class Sent:
    """Goal of a client of this server to the other machine's action."""

    def __init__(self, site: Site) -> None:
        self.results: list[Result] = []
        self.feedback: list[Any] = []
        goal = {"command": {"position": 0.5}}
        self.goal = site.graph.actions.send_goal(
            site.client, GRIP, GRIPPER, goal, self.results.append, self.feedback.append
        )


async def found_by(site: Site) -> None:
    await until(lambda: site.graph.actions.names.type_of(GRIP) == GRIPPER)


async def test_a_client_sends_a_goal_to_an_action_of_a_ros_2_machine_and_cancels_another() -> None:
    async with networked(call=(GRIP,), subscribe=("/*",)) as (site, machine):
        server = ActionServer(machine)
        await found_by(site)
        token = f"/SC/%/%/armbridge/%grip%_action%get_result/{dds(SERVICES['get_result'])}"
        await until(lambda: machine.has_token(token))
        sent = Sent(site)
        await until(lambda: server.requests)
        server.feedback(0.25)
        await until(lambda: sent.feedback)
        await server.end(SUCCEEDED, 0.5)
        await until(lambda: sent.results)
        assert site.graph.services.names.type_of(f"{GRIP}/_action/send_goal") is None
        other = Sent(site)
        assert other.goal is not None
        other.goal.cancel()
        await until(lambda: server.cancelled)
        await server.end(CANCELED, 0.0)
        await until(lambda: other.results)
    assert (server.requests[0].position, sent.feedback[0]["position"]) == (0.5, 0.25)
    assert (sent.results[0].ok, sent.results[0].status) == (True, SUCCEEDED)
    assert sent.results[0].values["position"] == 0.5
    assert (other.results[0].status, server.cancelled) == (CANCELED, [other.goal.goal_id])


async def test_a_goal_that_is_rejected_there_or_whose_machine_goes_fails() -> None:
    async with networked(call=(GRIP,)) as (site, machine):
        ActionServer(machine, accepts=False)
        await found_by(site)
        sent = Sent(site)
        await until(lambda: sent.results)
        assert sent.results[0].values == "Action /grip: its provider has rejected the goal"
    async with networked(call=(GRIP,)) as (site, machine):
        server = ActionServer(machine)
        await found_by(site)
        sent = Sent(site)
        await until(lambda: server.requests)
        machine.session.close()
        await until(lambda: sent.results)
        await until(lambda: site.graph.actions.names.type_of(GRIP) is None)
    assert not sent.results[0].ok
