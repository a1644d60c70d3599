"""A regular look at the server from within its event loop: how late the loop is, and a sign of life to systemd."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from server.operations.distribution import Distribution
from server.operations.health import Health
from server.operations.service_manager import ServiceManager

# Often enough to see what holds the loop up, seldom enough to cost nothing.
PERIOD_S = 0.25

LAG_BOUNDS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)

# Systemd recommends to be told at half its patience; a loop under load may miss one turn.
SIGNS_OF_LIFE = 3.0


class Heartbeat:
    """Measures and tells.

    Args:
        manager: is told while the server is alive.
        health: looks at the server.
        period_s: time between two looks [s].

    Attributes:
        lag_s: by how much the loop woke up too late.
    """

    def __init__(self, manager: ServiceManager, health: Callable[[], Health], period_s: float = PERIOD_S) -> None:
        self.lag_s = Distribution(LAG_BOUNDS_S)
        self._manager = manager
        self._health = health
        self._period_s = period_s
        self._sign_due_s = 0.0
        self._status = ""
        self._task: asyncio.Task[None] | None = None

    def open(self) -> None:
        """Begin."""
        self._task = asyncio.create_task(self._run(), name="heartbeat of the server")

    def close(self) -> None:
        """End."""
        if self._task is not None:
            self._task.cancel()

    def look(self, now_s: float) -> None:
        """Tell the service manager what it is to know now.

        Args:
            now_s: present time [s], monotonic.
        """
        self._manager.tell_again()
        watchdog_s = self._manager.watchdog_s
        health = self._health()
        status = "; ".join(health.reasons or health.warnings) or "ready"
        if status != self._status:
            self._status = status
            self._manager.tell_status(status)
        if watchdog_s and health.live and now_s >= self._sign_due_s:
            self._sign_due_s = now_s + watchdog_s / SIGNS_OF_LIFE
            self._manager.tell_alive()

    async def _run(self) -> None:
        while True:
            due_s = time.monotonic() + self._period_s
            await asyncio.sleep(self._period_s)
            now_s = time.monotonic()
            self.lag_s.take(max(0.0, now_s - due_s))
            self.look(now_s)
