"""A pair of arms in one robot, served and moved over a real socket: each group by itself, and both together."""

from collections.abc import Iterator
from typing import Any

import pytest

from harness.clients import FrameClient
from harness.server import RunningServer
from tests.helpers.robots import PAIR_SRDF, PAIR_URDF, folder_arguments

# What the lag of an ideal joint leaves over [rad].
ARRIVED = 0.005

GROUP_TOPIC, RESULT = "/moveit_goal_group", "/moveit_goal_result"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    arguments = folder_arguments(tmp_path_factory.mktemp("pair"), PAIR_URDF, PAIR_SRDF)
    with RunningServer(f"--port 0 {arguments}") as running:
        yield running


def joints(**positions: float) -> dict[str, Any]:
    return {"name": list(positions), "position": list(positions.values())}


async def test_a_named_goal_moves_the_selected_group_and_a_goal_of_joints_the_groups_of_these(
    client: FrameClient,
) -> None:
    assert (await client.reach("/moveit_goal_joints", joints(left_a1=0.3, right_a1=-0.3)))["val"] == 1
    both = await client.positions()
    assert (both["left_a1"], both["right_a1"]) == pytest.approx((0.3, -0.3), abs=ARRIVED)
    await client.subscribe(GROUP_TOPIC, "std_msgs/String")
    await client.send({"op": "advertise", "topic": GROUP_TOPIC, "type": "std_msgs/String"})
    await client.publish(GROUP_TOPIC, {"data": "left_arm"})
    await client.until(GROUP_TOPIC, lambda told: told[-1]["data"] == "left_arm")
    assert (await client.reach("/moveit_goal_named", {"data": "bent"}))["val"] == 1
    bent = await client.positions()
    assert (bent["left_a1"], bent["left_a4"]) == pytest.approx((0.0, 1.2), abs=ARRIVED)
    assert (bent["right_a1"], bent["right_a4"]) == pytest.approx((-0.3, both["right_a4"]), abs=ARRIVED)


async def test_two_arms_move_at_the_same_time(client: FrameClient) -> None:
    # So slowly that one still moves when the other begins, however late that is planned.
    await client.set_speed(0.1)
    await client.publish("/moveit_goal_joints", joints(left_a1=1.2, left_a2=0.4))
    await client.publish("/moveit_goal_joints", joints(right_a1=-1.2, right_a2=0.4))

    def both_move(states: list[dict[str, Any]]) -> bool:
        speed = dict(zip(states[-1]["name"], states[-1]["velocity"], strict=True))
        return speed["left_a1"] > 0.01 and speed["right_a1"] < -0.01

    await client.until("/joint_states", both_move)
    await client.set_speed(1.0)
    assert [result["val"] for result in await client.until(RESULT, lambda told: len(told) == 2)] == [1, 1]
