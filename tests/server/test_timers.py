from __future__ import annotations

import asyncio

import pytest

from server.timers import call_later

pytestmark = pytest.mark.stepped_time


async def test_an_action_happens_after_its_delay() -> None:
    happened = asyncio.Event()
    call_later(0.01, happened.set)
    assert not happened.is_set()
    await asyncio.wait_for(happened.wait(), 1.0)


async def test_a_cancelled_action_does_not_happen() -> None:
    happened = asyncio.Event()
    call_later(0.01, happened.set).cancel()
    await asyncio.sleep(0.03)
    assert not happened.is_set()
