"""Client that keeps the planners busy: goals of every kind, each stopped as soon as it moves the arm."""

from __future__ import annotations

import asyncio
import random
import sys
import time

from harness.clients import FrameClient, frame_client

SEED = 3


async def flood(url: str, seconds: float) -> None:
    """Send goals for a while."""
    chance = random.Random(SEED)
    until_s = time.monotonic() + seconds
    async with frame_client(url) as client:
        await client.open_goals()
        while time.monotonic() < until_s:
            await _one_goal(client, chance)


async def _one_goal(client: FrameClient, chance: random.Random) -> None:
    seen = len(client.messages("/moveit_goal_result"))
    if chance.random() < 0.5:
        names = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
        positions = [chance.uniform(-1.6, 1.6) for _ in names]
        await client.publish("/moveit_goal_joints", {"name": names, "position": positions})
    else:
        x, y, z = chance.uniform(0.0, 0.5), chance.uniform(-0.3, 0.3), chance.uniform(0.0, 0.4)
        await client.publish("/moveit_goal_pose", {"pose": {"position": {"x": x, "y": y, "z": z}}})
    await asyncio.sleep(0.1)
    await client.publish("/stop", {})
    await client.wait_for("/moveit_goal_result", lambda all_: len(all_) > seen)


if __name__ == "__main__":
    asyncio.run(flood(f"ws://127.0.0.1:{sys.argv[1]}", float(sys.argv[2])))
