"""Teaching by hand on the emulated arm, and replays of what was taught."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from harness.clients import ArmClient, arm_client
from harness.server import ServerOnBus, server_on_bus
from harness.waiting import TIMEOUT_S
from robot.trajectory import Vector
from tests.helpers.moveit import box, pose
from tests.helpers.robots import nominal_calibration
from tests.server.conftest import FAST

STATE, STATE_TYPE = "/teach/state", "armbridge_msgs/TeachState"
REPLAY, REPLAY_TYPE = "/replay_motion", "armbridge_msgs/action/ReplayMotion"
SERVOS = {joint.joint: joint for joint in nominal_calibration().joints}
JOINTS = tuple(SERVOS)

# Where the hand leads the arm [rad]: up from the folded pose, to the side and back.
WAY = (
    {"shoulder_pan": 0.4, "elbow_flex": 0.3},
    {"shoulder_pan": 0.4, "elbow_flex": 0.6, "gripper": 0.8},
    {"shoulder_pan": -0.3, "elbow_flex": 0.2, "gripper": 0.8},
)


# The smoothing's tolerance, play of gears, and what a servo lags behind.
PATH_TOLERANCE_RAD = 0.06


@pytest.fixture(scope="module")
def arm() -> Iterator[ServerOnBus]:
    with server_on_bus(**FAST) as running:
        yield running


@asynccontextmanager
async def teacher(arm: ServerOnBus) -> AsyncIterator[ArmClient]:
    async with arm_client(arm.server.url) as client:
        await client.say("subscribe", topic=STATE, type=STATE_TYPE)
        yield client


def positions(state: dict[str, Any]) -> dict[str, float]:
    return dict(zip(state["name"], state["position"], strict=True))


async def lead(client: ArmClient, arm: ServerOnBus, to_rad: dict[str, float]) -> None:
    """Lead the relaxed arm by hand, and wait until it is there."""
    ticks = {str(SERVOS[name].servo_id): round(SERVOS[name].ticks_from_rad(at)) for name, at in to_rad.items()}
    arm.emulator.command(hand=ticks)

    def there(states: list[dict[str, Any]]) -> bool:
        now = positions(states[-1])
        return all(abs(now[name] - at) < 0.02 for name, at in to_rad.items())

    await client.until("/joint_states", there)


async def taught(client: ArmClient, arm: ServerOnBus, name: str) -> dict[str, Any]:
    """Teach a motion by hand; returns the answer to the end."""
    assert (await client.call("/arm/relax"))["success"]
    await client.until_mode("relaxed")
    await lead(client, arm, {"shoulder_pan": 0.0, "elbow_flex": 0.0, "gripper": 0.2})
    begun = await client.call("/teach/begin", name=name, group="")
    assert begun["success"], begun
    assert "hold it" in begun["message"]
    for to_rad in WAY:
        await lead(client, arm, to_rad)
    ended = await client.call("/teach/end")
    assert ended["success"], ended
    return ended


async def ready(client: ArmClient, arm: ServerOnBus) -> None:
    """Switch the arm on, then let go of it."""
    assert (await client.call("/arm/enable"))["success"]
    await client.until_mode("holding")
    arm.emulator.command(hand={str(joint.servo_id): None for joint in SERVOS.values()})


async def replayed(client: ArmClient, arm: ServerOnBus, name: str, **goal: Any) -> dict[str, Any]:
    """Replay a motion; returns the result."""
    await ready(client, arm)
    sent = await client.send_goal(REPLAY, REPLAY_TYPE, {"name": name, "speed": 2.0, **goal})
    values: dict[str, Any] = (await asyncio.wait_for(client.result(sent), TIMEOUT_S))["values"]
    return values


def path_of(message: dict[str, Any], joints: tuple[str, ...]) -> Vector:
    """Points of a trajectory_msgs/JointTrajectory, shape (n, joints) [rad]."""
    columns = [message["joint_names"].index(name) for name in joints]
    return np.array([point["positions"] for point in message["points"]])[:, columns]


async def test_an_arm_that_was_led_by_hand_follows_the_same_path_again(arm: ServerOnBus) -> None:
    async with teacher(arm) as client:
        ended = await taught(client, arm, "wave")
        assert "touches nothing" in ended["message"]
        got = await client.call("/teach/get", name="wave")
        path = path_of(got["trajectory"], JOINTS)
        assert len(path) == ended["points"]
        client.topics["/joint_states"].clear()
        done = await replayed(client, arm, "wave")
        assert done["error_code"]["val"] == 1, done
        seen = np.array([[positions(state)[name] for name in JOINTS] for state in client.topics["/joint_states"]])
        # Every place that was taught is passed, in the taught order.
        after = 0
        for point in path[:: max(1, len(path) // 20)]:
            away = np.max(np.abs(seen[after:] - point), axis=1)
            assert away.min() < PATH_TOLERANCE_RAD, point
            after += int(np.argmax(away < PATH_TOLERANCE_RAD))


async def put_crate(client: ArmClient, name: str) -> None:
    """Put a crate where the tip is half-way on a motion."""
    trajectory = (await client.call("/teach/get", name=name))["trajectory"]
    points = trajectory["points"]
    state = {"joint_state": {"name": trajectory["joint_names"], "position": points[len(points) // 2]["positions"]}}
    tip = await client.call("/compute_fk", fk_link_names=["gripper_frame_link"], robot_state=state)
    place = tip["pose_stamped"][0]["pose"]["position"]
    await client.change_scene(box("crate", at=pose(place["x"], place["y"], place["z"]), frame="base_link"))


async def remove_crate(client: ArmClient) -> None:
    await client.change_scene({"id": "crate", "operation": 1})


async def test_a_replay_brakes_when_something_comes_into_its_way(arm: ServerOnBus) -> None:
    async with teacher(arm) as client:
        ended = await taught(client, arm, "surprised")
        sent = await begun_slowly(client, arm, "surprised", ended["duration_s"])
        await put_crate(client, "surprised")
        values = (await asyncio.wait_for(client.result(sent), TIMEOUT_S))["values"]
        assert values["error_code"]["val"] == -3
        assert "crate" in values["message"]
        await remove_crate(client)


async def begun_slowly(client: ArmClient, arm: ServerOnBus, name: str, duration_s: float) -> str:
    """Begin a replay at a tenth of its speed; returns its goal when it follows the taught path."""
    await ready(client, arm)
    sent = await client.send_goal(REPLAY, REPLAY_TYPE, {"name": name, "speed": 0.1})

    async def follows() -> None:
        while not any(0.0 < each["remaining_s"] < 9.9 * duration_s for each in client.feedback.get(sent, ())):
            await asyncio.sleep(0.02)

    await asyncio.wait_for(follows(), TIMEOUT_S)
    return sent
