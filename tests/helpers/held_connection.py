"""Connection whose pongs a test gives, for clients that publish."""

import asyncio
import json
from collections.abc import Awaitable
from typing import Any


class HeldConnection:
    """Takes frames; pings wait for the test."""

    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []
        self.pings: list[asyncio.Future[float]] = []

    async def send(self, message: str) -> None:
        self.sent.append(json.loads(message))

    async def ping(self) -> Awaitable[float]:
        self.pings.append(asyncio.get_running_loop().create_future())
        return self.pings[-1]

    @property
    def messages(self) -> list[dict[str, Any]]:
        """Messages that were published."""
        return [each["msg"] for each in self.sent if each["op"] == "publish"]
