from __future__ import annotations

import asyncio
import logging
import os
import pty
import signal
from collections.abc import AsyncIterator

import pytest

from harness.waiting import until
from robot.logs import OUR_LOGGER
from server import lifecycle
from server.lifecycle import on_hangup, toggle_debug


class Told:
    """Record of the calls that a hangup leads to."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def reload(self) -> None:
        self.calls.append("reload")

    def end(self) -> None:
        self.calls.append("end")

    async def after_hangup(self) -> list[str]:
        signal.raise_signal(signal.SIGHUP)
        await until(lambda: self.calls)
        return self.calls


@pytest.fixture
async def told() -> AsyncIterator[Told]:
    yield Told()
    asyncio.get_running_loop().remove_signal_handler(signal.SIGHUP)


async def test_a_service_reads_its_files_again(told: Told) -> None:
    on_hangup(told.reload, told.end, lambda _descriptor: False)
    assert await told.after_hangup() == ["reload"]


@pytest.mark.parametrize(("gone", "call"), [(False, "reload"), (True, "end")])
async def test_a_program_in_a_terminal_reads_its_files_again_and_ends_with_the_terminal(
    told: Told, gone: bool, call: str
) -> None:
    ours, theirs = pty.openpty()
    on_hangup(told.reload, told.end, lambda _descriptor: os.isatty(theirs))
    if gone:
        os.close(ours)
    assert await told.after_hangup() == [call]
    for descriptor in (theirs,) if gone else (ours, theirs):
        os.close(descriptor)


@pytest.mark.usefixtures("levels_are_put_back")
def test_the_signal_begins_and_ends_debugging(caplog: pytest.LogCaptureFixture) -> None:
    toggle_debug()
    assert lifecycle.log.isEnabledFor(logging.DEBUG)
    toggle_debug()
    assert logging.getLogger(OUR_LOGGER).level == logging.NOTSET
    assert ["debug now" in record.message for record in caplog.records] == [True, False]
