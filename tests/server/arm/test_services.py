from typing import Any

import pytest

from harness.clients import ArmClient, values_of
from protocol.errors import MessageError
from robot.messages import ChangePace
from server.arm.interface import PAUSE, RESUME, SPEED_FACTOR_TOPIC, SPEED_LIMIT, STEP_BACK, offer_pace
from server.graph.permissions import Node
from server.graph.topics import Graph, LocalGraph
from tests.helpers.fake_arm import FakeArm
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY

RESULT = "/moveit_goal_result"


async def pan_to(client: ArmClient, position_rad: float) -> None:
    msg = {"name": ["shoulder_pan"], "position": [position_rad]}
    await client.goal("/moveit_goal_joints", "sensor_msgs/JointState", msg)


async def begin_to_move(client: ArmClient) -> None:
    """Move away from where the pan joint is; returns on the way."""
    pan_rad = (await client.until("/joint_states", bool))[-1]["position"][0]
    await pan_to(client, -1.5 if pan_rad > 0.0 else 1.5)
    await client.until("/joint_states", lambda states: abs(states[-1]["position"][0] - pan_rad) > 0.3)


async def results(client: ArmClient, count: int = 1) -> list[dict[str, Any]]:
    return await client.until(RESULT, lambda all_: len(all_) >= count)


async def test_relaxing_ends_the_goals_and_others_are_refused_until_the_arm_is_enabled(client: ArmClient) -> None:
    await begin_to_move(client)
    await pan_to(client, 0.0)
    assert (await client.call("/arm/relax"))["success"]
    await client.until_mode("relaxed")
    await results(client, 2)
    await pan_to(client, 0.3)
    *ended, refused = await results(client, 3)
    assert [result["val"] for result in ended] == [-7, -7]
    assert refused["val"] == -4
    assert "/arm/enable" in refused["message"]
    assert (await client.call("/arm/enable"))["success"]
    await pan_to(client, 0.3)
    assert (await results(client, 4))[3]["val"] == 1


async def test_stop_is_answered_when_the_arm_stands(client: ArmClient) -> None:
    await begin_to_move(client)
    assert await client.call("/arm/stop") == {"success": True, "message": "the arm does not move"}
    await client.until_mode("holding")
    assert (await results(client))[0]["val"] == -7


async def test_an_emergency_stop_cuts_torque_ends_goals_and_needs_a_reset(client: ArmClient) -> None:
    await begin_to_move(client)
    await pan_to(client, 0.0)
    assert await client.call("/arm/emergency_stop") == {"success": True, "message": "torque is off at every servo"}
    assert values_of(await client.until_mode("fault"))["fault"] == "emergency_stop"
    by_goal = {result["message"] for result in await results(client, 2)}
    assert any("emergency stop: torque is off" in message for message in by_goal)
    refused = await client.call("/arm/enable")
    assert not refused["success"]
    assert "reset the fault" in refused["message"]
    assert (await client.call("/arm/reset_fault"))["success"]
    await client.until_mode("relaxed")


async def test_a_stop_whose_message_does_not_fit_stops(client: ArmClient) -> None:
    stops = [("publish", "topic", "/stop", "msg", msg) for msg in ({"data": False}, None, [], "stop")]
    stops += [("call_service", "service", "/arm/stop", "args", {"data": True})]
    for op, kind, name, field, value in stops:
        before = values_of((await client.until("/arm/state", bool))[-1])["last_stop"]
        await client.say(op, **{kind: name, field: value})
        await client.until("/arm/state", lambda states, before=before: values_of(states[-1])["last_stop"] != before)


async def test_every_kind_of_stop_is_numbered_and_a_stop_of_a_part_is_none_of_the_arm(client: ArmClient) -> None:
    for service in ("/arm/stop", "/arm/chunks/stop", "/servo_node/stop_servo", "/teleop/stop"):
        before = values_of((await client.until("/arm/state", bool))[-1])
        await client.call(service)
        states = await client.until(
            "/arm/state", lambda states, stops=before["stops"]: int(values_of(states[-1])["stops"]) > int(stops)
        )
        assert (values_of(states[-1])["last_stop"] > before["last_stop"]) == (service == "/arm/stop")


@pytest.mark.parametrize("msg", [{}, None], ids=["empty", "that does not fit"])
async def test_whatever_is_published_on_the_topic_stops(client: ArmClient, msg: Any) -> None:
    await client.say("advertise", topic="/emergency_stop", type="std_msgs/Empty")
    await client.say("publish", topic="/emergency_stop", msg=msg)
    await client.until_mode("fault")


class Desk:
    """The services of one arm's pace, and those of one of several."""

    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.arm, self.left = FakeArm(), FakeArm()
        offer_pace(LocalGraph(self.graph), self.arm.as_arm)
        offer_pace(LocalGraph(self.graph, "left"), self.left.as_arm)

    def call(self, service: str, **request: Any) -> Any:
        return answered(self.graph, service, **request).values

    def set_factor(self, factor: Any) -> None:
        self.graph.publish(Node("client"), SPEED_FACTOR_TOPIC, {"data": factor})


@pytest.fixture
async def desk() -> Desk:
    return Desk()


async def test_a_speed_limit_below_the_name_of_one_of_several_arms_is_that_of_this_arm(desk: Desk) -> None:
    assert desk.call(f"/left{SPEED_LIMIT}", speed_limit=0.5)["success"]
    assert (desk.left.changes, desk.arm.changes) == ([ChangePace(speed_limit=0.5)], [])
    assert "/left/arm/pause" in desk.call(f"/left{SPEED_LIMIT}", speed_limit=0.0)["message"]


@pytest.mark.parametrize("service", [PAUSE, RESUME, STEP_BACK])
async def test_without_a_motion_there_is_nothing_to_pause(desk: Desk, service: str) -> None:
    answer = desk.call(service)
    assert not answer["success"]
    assert "holding" in answer["message"]
    assert desk.arm.changes == []


@pytest.mark.parametrize("limit", [0.0, 0.009, -0.5, 1.01, float("nan"), float("inf")])
async def test_a_speed_limit_out_of_range_is_refused_with_range_value_and_remedy(desk: Desk, limit: float) -> None:
    answer = desk.call(SPEED_LIMIT, speed_limit=limit)
    assert not answer["success"]
    assert f"speed_limit must be 0.01 to 1, a share of the joints' velocity limits, not {limit:g}" in answer["message"]
    assert PAUSE in answer["message"]
    assert desk.arm.changes == []


async def test_a_speed_factor_is_passed_on_if_it_is_a_share(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    shares = (0.0, 0.25, 1.0)
    for factor in shares:
        desk.set_factor(factor)
    for factor in (-0.1, 1.5, float("nan")):
        desk.set_factor(factor)
        assert f"must be 0 to 1, a share of the planned speed, not {factor}" in caplog.text
    caplog.clear()
    with pytest.raises(MessageError):
        desk.set_factor("fast")
    assert SPEED_FACTOR_TOPIC in caplog.text
    assert desk.arm.changes == [ChangePace(speed_factor=factor) for factor in shares]


async def test_a_motion_is_paused_goes_back_and_arrives_after_all(client: ArmClient) -> None:
    await pan_to(client, 0.0)
    # A motion of a former test may end first.
    ended = len(await client.until(RESULT, lambda ends: ends[-1]["val"] == 1))
    # So slow that no busy machine sees its end before the pause.
    await client.say("publish", topic=SPEED_FACTOR_TOPIC, msg={"data": 0.1})
    await pan_to(client, 1.2)
    await client.until("/joint_states", lambda states: states[-1]["position"][0] > 0.3)
    assert (await client.call(PAUSE))["success"]
    await client.say("publish", topic=SPEED_FACTOR_TOPIC, msg={"data": 1.0})
    await client.until("/arm/state", lambda states: values_of(states[-1])["course"] == "paused")
    standing = (await client.until("/joint_states", lambda states: abs(states[-1]["velocity"][0]) < 0.02))[-1]
    assert (await client.call(STEP_BACK))["success"]
    await client.until("/joint_states", lambda states: states[-1]["position"][0] < standing["position"][0] - 0.1)
    assert len(client.topics[RESULT]) == ended
    assert (await client.call(RESUME))["success"]
    assert (await results(client, ended + 1))[ended]["val"] == 1
    assert client.topics["/joint_states"][-1]["position"][0] == pytest.approx(1.2, abs=0.06)
