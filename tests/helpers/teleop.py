"""Starts of teleoperation on a machine that may be busy."""

import asyncio
from typing import Any

from harness.clients import ArmClient
from harness.waiting import TIMEOUT_S


async def follow(client: ArmClient, below: str, **request: Any) -> None:
    """Start a following by the services below a name, and wait until the follower is with its leader."""
    topic = f"{below}/state"
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            while not (answer := await client.call(f"{below}/start", **request))["success"]:
                # The way to the leader of the test before may still be braking.
                assert "it is in use" in answer["message"]
            client.topics.get(topic, []).clear()
            states = await client.until(topic, lambda states: states[-1]["phase"] in ("following", "idle"))
            if states[-1]["phase"] == "following":
                return
            # With planners that do not come to their turn within two seconds a following ends; it may be started again.
            assert "has not set out for the leader" in states[-1]["message"], states[-1]["message"]
