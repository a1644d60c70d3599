"""Followings on a machine that may be busy."""

import asyncio
from collections.abc import Callable
from typing import Any

from harness.clients import ArmClient
from harness.waiting import TIMEOUT_S

# What ends a following, or refuses it, where a process does not get its turn: it may be started again.
LATE = ("has not set out for the leader", "has sent nothing for")


def is_late(message: str) -> bool:
    """Return true for the message of a following that a starved process has ended."""
    return any(words in message for words in LATE)


async def follow(client: ArmClient, below: str, **request: Any) -> None:
    """Start a following by the services below a name, and wait until the follower is with its leader."""
    topic = f"{below}/state"
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            while not (answer := await client.call(f"{below}/start", **request))["success"]:
                # The way to the leader of the test before may still be braking.
                assert "it is in use" in answer["message"] or is_late(answer["message"]), answer["message"]
            client.topics.get(topic, []).clear()
            states = await client.until(topic, lambda states: states[-1]["phase"] in ("following", "idle"))
            if states[-1]["phase"] == "following":
                return
            assert is_late(states[-1]["message"]), states[-1]["message"]


async def led(
    client: ArmClient, is_there: Callable[[dict[str, float]], object], below: str = "/teleop", **request: Any
) -> None:
    """Follow until joints are somewhere, by their positions [rad]."""
    async with asyncio.timeout(TIMEOUT_S):
        while not is_there(await client.positions()):
            state = client.topics[f"{below}/state"][-1]
            if state["phase"] == "idle":
                assert is_late(state["message"]), state["message"]
                await follow(client, below, **request)
