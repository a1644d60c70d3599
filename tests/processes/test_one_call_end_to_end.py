"""Clients that know services and actions alone, and clients of ROS 1, on a running server with the simulated arm."""

from collections.abc import AsyncIterator, Iterator

import pytest

from harness.clients import ArmClient, arm_client
from harness.server import RunningServer

NAME, ACTION_TYPE = "/moveit_goal", "armbridge_msgs/action/MoveitGoal"
PAN_RAD = 0.4
TURNED = {"joints": {"name": ["shoulder_pan"], "position": [PAN_RAD]}}
OUT_OF_REACH = {"pose": {"header": {"frame_id": "base_link"}, "pose": {"position": {"x": 1.0, "z": 0.2}}}}


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer() as running:
        yield running


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[ArmClient]:
    async with arm_client(server.url) as connected:
        yield connected


async def test_one_call_moves_the_arm_and_is_answered_when_it_is_there(client: ArmClient) -> None:
    await client.call(NAME, named="home")
    answer = await client.call(NAME, **TURNED)
    assert (answer["success"], answer["code_name"]) == (True, "SUCCESS")
    assert answer["duration_s"] > 0.0
    assert (await client.positions())["shoulder_pan"] == pytest.approx(PAN_RAD, abs=0.06)


async def test_a_plan_alone_leaves_the_arm_where_it_is(client: ArmClient) -> None:
    await client.call(NAME, **TURNED)
    answer = await client.call(NAME, named="rest", plan_only=True)
    assert answer["success"]
    assert answer["duration_s"] > 0.0
    assert (await client.positions())["shoulder_pan"] == pytest.approx(PAN_RAD, abs=0.06)


async def test_a_goal_out_of_reach_is_answered_with_one_that_works(client: ArmClient) -> None:
    refused = await client.call(NAME, **OUT_OF_REACH)
    assert (refused["success"], refused["code_name"]) == (False, "NO_IK_SOLUTION")
    answer = await client.call(NAME, **refused["suggested"], velocity_scaling=1.0, acceleration_scaling=1.0)
    assert answer["success"], answer["message"]


async def test_an_action_tells_how_it_goes_to_its_sender_and_on_its_topics(client: ArmClient) -> None:
    await client.call(NAME, named="home")
    await client.say("subscribe", topic=f"{NAME}/_action/status")
    await client.say("subscribe", topic=f"{NAME}/_action/feedback")
    goal_id = await client.send_goal(NAME, ACTION_TYPE, TURNED)
    result = await client.result(goal_id)
    assert (result["status"], result["values"]["code_name"]) == (4, "SUCCESS")
    states = [each["state"] for each in client.feedback[goal_id]]
    assert {"planning", "executing", "done"} <= set(states)
    assert any(each["seconds_left"] > 0.0 for each in client.feedback[goal_id])
    published = await client.until(
        f"{NAME}/_action/status", lambda all_: [each["status"] for each in all_[-1]["status_list"]][-1:] == [4]
    )
    told = client.topics[f"{NAME}/_action/feedback"]
    assert told[0]["goal_id"] == published[-1]["status_list"][-1]["goal_info"]["goal_id"]
    assert [each["feedback"]["state"] for each in told] == states
