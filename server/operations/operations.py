"""Operations as a whole: what is asked over HTTP, the log's levels, and the service manager."""

from __future__ import annotations

from collections.abc import Mapping

from websockets.http11 import Request

from server.gateway.http import Answer, Route
from server.graph.topics import Graph
from server.operations.health import Health, health_of
from server.operations.heartbeat import Heartbeat
from server.operations.log_levels import LogLevels
from server.operations.metrics_page import MetricsPage
from server.operations.parts import Parts
from server.operations.service_manager import ServiceManager


class Operations:
    """For whoever runs the server.

    Args:
        graph: where services are offered.
        manager: who has started the server.

    Attributes:
        parts: what is told of; each part is entered as soon as it is there.
        routes: what is answered over HTTP, by path.
    """

    def __init__(self, graph: Graph, manager: ServiceManager) -> None:
        self.parts = Parts()
        self._manager = manager
        self._log_levels = LogLevels(graph)
        self._heartbeat = Heartbeat(manager, self.health)
        self._metrics = MetricsPage(self.parts, self._heartbeat.lag_s)
        self.routes: Mapping[str, Route] = {
            "healthz": self._answer_ready,
            "readyz": self._answer_ready,
            "livez": self._answer_live,
            "metrics": self._metrics.answer,
        }

    def open(self) -> None:
        """Begin, before the other parts do."""
        self._log_levels.open()
        self._heartbeat.open()

    def tell_started(self) -> None:
        """All parts have started."""
        self.parts.started = True
        health = self.health()
        self._manager.tell_ready("; ".join(health.reasons) or "ready")

    def tell_stopping(self) -> None:
        """The parts are going to end."""
        self.parts.stopping = True
        self._manager.tell_stopping()

    def close(self) -> None:
        """End, after the other parts have."""
        self._heartbeat.close()
        self._manager.close()

    def health(self) -> Health:
        """How the server is."""
        return health_of(self.parts)

    async def _answer_ready(self, _request: Request) -> Answer:
        health = self.health()
        return health.answer(good=health.live and health.ready)

    async def _answer_live(self, _request: Request) -> Answer:
        health = self.health()
        return health.answer(good=health.live)
