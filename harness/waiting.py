"""Waits for events, each with a timeout that only a broken program meets."""

import asyncio
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.request import urlopen

# What takes a millisecond, and a start or a program that takes seconds, take very much longer on a busy machine.
TIMEOUT_S = 300.0


async def until(condition: Callable[[], object], timeout_s: float = TIMEOUT_S) -> None:
    """Let the event loop run until something is so."""
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.005)


def wait_until(condition: Callable[[], object], timeout_s: float = TIMEOUT_S) -> None:
    """As :func:`until`, without an event loop."""
    until_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until_s, "it has not come to it in time"
        time.sleep(0.005)


def until_classroom_ready(students: Path) -> None:
    """Wait until the servers in a classroom's list are ready."""
    wait_until(students.exists)
    for url in {line.split(",")[1] for line in students.read_text().splitlines()[1:]}:
        wait_until(partial(_is_ready, f"http{url.removeprefix('ws')}/readyz"))


def _is_ready(url: str) -> bool:
    try:
        urlopen(url, timeout=TIMEOUT_S).close()
    except OSError:  # nobody listens yet, or the server answers that it is not ready
        return False
    return True


def join(thread: threading.Thread) -> None:
    """Wait for the end of a thread."""
    thread.join(TIMEOUT_S)
    assert not thread.is_alive(), f"{thread.name} does not end"


@contextmanager
def killed_in_time(process: subprocess.Popen[str]) -> Iterator[None]:
    """Kill a program at the end of the time, so that no read from it waits without an end."""
    overdue = threading.Timer(TIMEOUT_S, process.kill)
    overdue.start()
    try:
        yield
    finally:
        overdue.cancel()


@contextmanager
def running(command: Sequence[str | Path], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a program; the end of the block or of its time kills it."""
    with subprocess.Popen(command, text=True, **options) as process, killed_in_time(process):
        try:
            yield process
        finally:
            process.kill()


async def given_up(*asking: asyncio.Task[Any]) -> None:
    """Cancel tasks that are not done, and wait for their end."""
    for task in asking:
        assert not task.done()
        task.cancel()
    await asyncio.wait(asking)
