"""Teaching by hand on the emulated arm, and replays of what was taught."""

import asyncio
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np

from harness.clients import ArmClient, arm_client
from harness.server import RunningServer, ServerOnBus
from harness.waiting import TIMEOUT_S
from tests.helpers.moveit import box, pose
from tests.helpers.robots import nominal_calibration

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


async def lead(client: ArmClient, arm: ServerOnBus, to_rad: dict[str, float]) -> None:
    """Lead the relaxed arm by hand, and wait until it is there."""
    arm.emulator.command(
        hand={str(SERVOS[name].servo_id): SERVOS[name].ticks_from_rad(to_rad[name]) for name in to_rad}
    )
    async with asyncio.timeout(TIMEOUT_S):
        now = await client.positions()
        while any(abs(now[name] - at) > 0.02 for name, at in to_rad.items()):
            now = await client.positions()


async def ready(client: ArmClient, arm: ServerOnBus) -> None:
    """Switch the arm on, then let go of it."""
    assert (await client.call("/arm/enable"))["success"]
    await client.until_mode("holding")
    arm.emulator.command(hand={str(joint.servo_id): None for joint in SERVOS.values()})


async def replay(client: ArmClient, speed: float) -> str:
    return await client.send_goal(REPLAY, REPLAY_TYPE, {"name": "wave", "speed": speed})


async def test_an_arm_that_was_led_by_hand_follows_the_same_path_again_and_brakes_for_what_comes_into_its_way(
    client: ArmClient, served: ServerOnBus
) -> None:
    assert (await client.call("/arm/relax"))["success"]
    await client.until_mode("relaxed")
    await lead(client, served, {"shoulder_pan": 0.0, "elbow_flex": 0.0, "gripper": 0.2})
    assert "hold it" in (await client.call("/teach/begin", name="wave", group=""))["message"]
    for to_rad in WAY:
        await lead(client, served, to_rad)
    ended = await client.call("/teach/end")
    assert "touches nothing" in ended["message"]
    trajectory = (await client.call("/teach/get", name="wave"))["trajectory"]
    columns = [trajectory["joint_names"].index(name) for name in JOINTS]
    path = np.array([point["positions"] for point in trajectory["points"]])[:, columns]
    assert len(path) == ended["points"]

    await ready(client, served)
    client.topics["/joint_states"].clear()
    done = (await client.result(await replay(client, 2.0)))["values"]
    assert done["error_code"]["val"] == 1, done
    assert_passed(client.messages("/joint_states"), path)

    # Slowly: a crate comes to where the tip is half-way.
    sent = await replay(client, 0.1)
    async with asyncio.timeout(TIMEOUT_S):
        while not any(0 < each["remaining_s"] < 9.9 * ended["duration_s"] for each in client.feedback.get(sent, ())):
            await asyncio.sleep(0.02)
    half_way = {"name": list(JOINTS), "position": path[len(path) // 2].tolist()}
    tip = await client.call("/compute_fk", fk_link_names=["gripper_frame_link"], robot_state={"joint_state": half_way})
    at = tip["pose_stamped"][0]["pose"]["position"]
    await client.change_scene(box("crate", at=pose(at["x"], at["y"], at["z"]), frame="base_link"))
    braked = (await client.result(sent))["values"]
    await client.change_scene({"id": "crate", "operation": 1})
    assert braked["error_code"]["val"] == -3
    assert "crate" in braked["message"]


async def test_a_disk_that_does_not_answer_keeps_no_server_from_its_work_nor_its_end(tmp_path: Path) -> None:
    stuck = tmp_path / "armbridge" / "scenes_so101" / "stuck.json"
    stuck.parent.mkdir(parents=True)
    os.mkfifo(stuck)
    with RunningServer("--port 0", {"XDG_DATA_HOME": str(tmp_path)}) as server:
        async with arm_client(server.url) as client:
            for _ in range(40):
                await client.say("call_service", service="/arm/scenes/load", args={"name": "stuck"})
            assert (await client.call("/teach/list"))["names"] == []
            # It can be opened once the server reads it.
            with await asyncio.to_thread(stuck.open, "wb"):
                code, _ = await asyncio.to_thread(server.end, signal.SIGTERM)
    assert code == 0


def assert_passed(states: list[dict[str, Any]], path: np.ndarray) -> None:
    """Assert that every place that was taught is passed, in the taught order."""
    seen = np.array(
        [[dict(zip(each["name"], each["position"], strict=True))[name] for name in JOINTS] for each in states]
    )
    after = 0
    for point in path[:: max(1, len(path) // 20)]:
        away = np.max(np.abs(seen[after:] - point), axis=1)
        assert away.min() < PATH_TOLERANCE_RAD, point
        after += int(np.argmax(away < PATH_TOLERANCE_RAD))
