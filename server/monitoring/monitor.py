"""Monitor of the server: HTTP routes for health and metrics, and a watch on its event loop that systemd hears of."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from http import HTTPStatus

from prometheus_client import Histogram
from websockets.http11 import Request

from server.gateway.http import Answer, Route
from server.monitoring.health import Health, Sources, check_health
from server.monitoring.metrics import Metrics
from server.monitoring.systemd import SystemdNotifier

# Often enough to notice anything that blocks the loop, seldom enough to cost nothing.
PERIOD_S = 0.25

# sd_watchdog_enabled(3) recommends half the timeout between two notifications; a loop under load may miss one.
WATCHDOG_NOTIFICATIONS = 3.0


class Monitor:
    """Monitor of the server.

    Args:
        notifier: notifies systemd.

    Attributes:
        sources: parts of the server; each is entered as soon as it has been started.
        routes: handlers of HTTP requests, by path.
    """

    def __init__(self, notifier: SystemdNotifier) -> None:
        self.sources = Sources()
        self._notifier = notifier
        self._metrics = Metrics(self.sources)
        self._event_loop = EventLoopMonitor(notifier, self.health, self._metrics.loop_lag_s)
        self.routes: Mapping[str, Route] = {
            "healthz": self._on_readyz,
            "readyz": self._on_readyz,
            "livez": self._on_livez,
            "metrics": self._on_metrics,
        }

    async def run(self) -> None:
        """Watch the event loop, until cancelled."""
        await self._event_loop.run()

    def notify_started(self) -> None:
        """Take note of the end of the start, and notify systemd."""
        self.sources.started = True
        self._notifier.notify_ready("; ".join(self.health().reasons) or "ready")

    def notify_stopping(self) -> None:
        """Take note of the begin of the stop, and notify systemd."""
        self.sources.stopping = True
        self._notifier.notify_stopping()

    def close(self) -> None:
        """Send the last notifications; nothing is notified any more."""
        self._notifier.close()

    def health(self) -> Health:
        """Return the health of the server at this moment."""
        return check_health(self.sources)

    async def _on_readyz(self, _request: Request) -> Answer:
        health = self.health()
        return health.response(good=health.live and health.ready)

    async def _on_livez(self, _request: Request) -> Answer:
        health = self.health()
        return health.response(good=health.live)

    async def _on_metrics(self, request: Request) -> Answer:
        exposition = self._metrics.expose(", ".join(request.headers.get_all("Accept")))
        return Answer.of_data(HTTPStatus.OK, exposition.text, exposition.media_type)


class EventLoopMonitor:
    """Measures the lag of the event loop, and keeps systemd's watchdog and status line up to date.

    Args:
        notifier: notifies systemd.
        health: returns the health of the server.
        lag_s: takes the delay of each wake-up [s].
        period_s: time between two checks [s].
    """

    def __init__(
        self, notifier: SystemdNotifier, health: Callable[[], Health], lag_s: Histogram, period_s: float = PERIOD_S
    ) -> None:
        self._notifier = notifier
        self._health = health
        self._lag_s = lag_s
        self._period_s = period_s
        self._watchdog_due_s = 0.0
        self._status = ""

    async def run(self) -> None:
        """Check regularly, until cancelled."""
        while True:
            due_s = time.monotonic() + self._period_s
            await asyncio.sleep(self._period_s)
            now_s = time.monotonic()
            self._lag_s.observe(max(0.0, now_s - due_s))
            self.check(now_s)

    def check(self, now_s: float) -> None:
        """Notify systemd of changes, and of the server being alive.

        Args:
            now_s: present time [s], monotonic.
        """
        self._notifier.flush()
        watchdog_s = self._notifier.watchdog_s
        health = self._health()
        status = "; ".join(health.reasons or health.warnings) or "ready"
        if status != self._status:
            self._status = status
            self._notifier.notify_status(status)
        if watchdog_s and health.live and now_s >= self._watchdog_due_s:
            self._watchdog_due_s = now_s + watchdog_s / WATCHDOG_NOTIFICATIONS
            self._notifier.notify_watchdog()
