from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from server.operations import heartbeat as heartbeat_module
from server.operations.health import Health
from server.operations.heartbeat import SIGNS_OF_LIFE, Heartbeat
from server.operations.service_manager import ServiceManager
from tests.helpers.stepped_loop import SteppedLoop

WELL = Health(live=True, ready=True)
DEAD = Health(live=False, ready=False, reasons=("the arm process has been silent", "and so on"))


class Listening(ServiceManager):
    """A service manager that keeps what it is told."""

    def __init__(self, watchdog_s: float = 3.0) -> None:
        super().__init__()
        self.watchdog_s = watchdog_s
        self.heard: list[str] = []

    def tell_alive(self) -> None:
        self.heard.append("alive")

    def tell_status(self, status: str) -> None:
        self.heard.append(status)


def test_a_sign_of_life_comes_well_before_it_is_missed() -> None:
    manager = Listening(watchdog_s=3.0)
    heartbeat = Heartbeat(manager, lambda: WELL)
    for tick in range(13):
        heartbeat.look(100.0 + 0.25 * tick)
    assert manager.heard == ["ready", *["alive"] * (1 + int(SIGNS_OF_LIFE))]


def test_a_server_that_is_not_live_gives_no_sign_of_life() -> None:
    manager = Listening()
    heartbeat = Heartbeat(manager, lambda: DEAD)
    for now_s in range(100, 130):
        heartbeat.look(float(now_s))
    assert manager.heard == ["the arm process has been silent; and so on"]


def test_no_sign_of_life_is_given_where_nobody_waits_for_it() -> None:
    manager = Listening(watchdog_s=0.0)
    heartbeat = Heartbeat(manager, lambda: WELL)
    heartbeat.look(100.0)
    assert manager.heard == ["ready"]


def test_the_status_is_told_when_it_changes() -> None:
    manager, found = Listening(watchdog_s=0.0), [WELL, WELL, DEAD, DEAD, WELL]
    heartbeat = Heartbeat(manager, lambda: found.pop(0))
    for now_s in range(5):
        heartbeat.look(float(now_s))
    assert manager.heard == ["ready", "the arm process has been silent; and so on", "ready"]


@pytest.mark.stepped_time
async def test_what_holds_the_loop_up_shows_as_its_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, SteppedLoop)
    monkeypatch.setattr(heartbeat_module, "time", SimpleNamespace(monotonic=loop.time))
    heartbeat = Heartbeat(Listening(), lambda: WELL, period_s=0.01)
    heartbeat.open()
    await asyncio.sleep(0.055)
    assert heartbeat.lag_s.total == pytest.approx(0.0)
    loop.advance(0.1)
    await asyncio.sleep(0.02)
    heartbeat.close()
    # The look that was due 5 ms later came when the loop was free again.
    assert heartbeat.lag_s.total == pytest.approx(0.095)
    assert sum(heartbeat.lag_s.counts) == 7
