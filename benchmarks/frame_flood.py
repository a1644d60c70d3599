"""Client that publishes without pause, as fast as the server reads."""

from __future__ import annotations

import asyncio
import sys
import time

from harness.clients import frame_client

TOPIC, TYPE = "/flood", "sensor_msgs/JointState"
NAMES = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]


async def flood(url: str, seconds: float) -> None:
    """Publish for a while."""
    until_s = time.monotonic() + seconds
    async with frame_client(url) as client:
        await client.send({"op": "advertise", "topic": TOPIC, "type": TYPE})
        while time.monotonic() < until_s:
            await client.publish(TOPIC, {"name": NAMES, "position": [0.1] * len(NAMES)})


if __name__ == "__main__":
    asyncio.run(flood(sys.argv[1], float(sys.argv[2])))
