from __future__ import annotations

import asyncio
import os
import pty
import signal
from collections.abc import AsyncIterator

import pytest

from server.hangup import on_hangup


class Told:
    """What a hangup has led to."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def reload(self) -> None:
        self.calls.append("reload")

    def end(self) -> None:
        self.calls.append("end")

    async def after_hangup(self) -> list[str]:
        signal.raise_signal(signal.SIGHUP)
        async with asyncio.timeout(30.0):
            while not self.calls:
                await asyncio.sleep(0.005)
        return self.calls


@pytest.fixture
async def told() -> AsyncIterator[Told]:
    yield Told()
    asyncio.get_running_loop().remove_signal_handler(signal.SIGHUP)


async def test_a_service_reads_its_files_again(told: Told) -> None:
    on_hangup(told.reload, told.end, lambda _descriptor: False)
    assert await told.after_hangup() == ["reload"]


async def test_a_program_in_a_terminal_reads_its_files_again_when_it_is_asked_to(told: Told) -> None:
    ours, theirs = pty.openpty()
    on_hangup(told.reload, told.end, lambda _descriptor: os.isatty(theirs))
    assert await told.after_hangup() == ["reload"]
    os.close(ours)
    os.close(theirs)


async def test_a_program_whose_terminal_is_gone_ends(told: Told) -> None:
    ours, theirs = pty.openpty()
    on_hangup(told.reload, told.end, lambda _descriptor: os.isatty(theirs))
    os.close(ours)
    assert await told.after_hangup() == ["end"]
    os.close(theirs)
