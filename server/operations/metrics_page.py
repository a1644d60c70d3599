"""``/metrics``: loads what makes the text when somebody asks for it, for most servers are never asked."""

from __future__ import annotations

import asyncio
import time
from http import HTTPStatus
from typing import TYPE_CHECKING

from websockets.http11 import Request

from server.gateway.http import Answer
from server.operations.distribution import Distribution
from server.operations.parts import Parts

if TYPE_CHECKING:
    from server.operations.metrics.exposition import Exposition


class MetricsPage:
    """Answers who scrapes.

    Args:
        parts: what is told of.
        lag_s: of the event loop.
    """

    def __init__(self, parts: Parts, lag_s: Distribution) -> None:
        self._parts = parts
        self._lag_s = lag_s
        self._started_s = time.time()
        self._exposition: Exposition | None = None

    async def answer(self, request: Request) -> Answer:
        """The metrics of this moment."""
        if self._exposition is None:
            # In a thread, for it takes longer than a motion's states may be held up.
            make = await asyncio.to_thread(_load)
            self._exposition = make(self._parts, self._lag_s, self._started_s)
        exposed = self._exposition.expose(", ".join(request.headers.get_all("Accept")))
        return Answer.of_data(HTTPStatus.OK, exposed.text, exposed.media_type)


def _load() -> type[Exposition]:
    from server.operations.metrics.exposition import Exposition

    return Exposition
