"""Processes that want a core."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest


@pytest.fixture
def start_on_one_core() -> Iterator[Callable[[], int]]:
    """Start processes that want one core all the time, always the same; each returns its id."""
    program = f"import os; os.sched_setaffinity(0, {{{max(os.sched_getaffinity(0))}}})\nwhile True: pass"
    started: list[subprocess.Popen[bytes]] = []

    def start() -> int:
        # Each in a session of its own: a kernel that shares cores out by session would give all one worker's share.
        started.append(subprocess.Popen([sys.executable, "-c", program], start_new_session=True))
        return started[-1].pid

    yield start
    for process in started:
        process.kill()
        process.wait()
