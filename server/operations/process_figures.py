"""What a process uses, by the kernel's account."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

# Bytes of a page, and ticks a second, in which the kernel counts.
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
TICKS_HZ = os.sysconf("SC_CLK_TCK")

# Of /proc/PID/stat, counted from behind the name, which may have any characters in it.
_USER_TICKS, _SYSTEM_TICKS, _THREADS, _RESIDENT_PAGES = 11, 12, 17, 21


class ProcessFigures(NamedTuple):
    """One process.

    Attributes:
        resident_bytes: memory that it holds.
        cpu_s: processor time that it has used [s].
        threads: how many it has.
        open_files: how many file descriptors it has open.
    """

    resident_bytes: int
    cpu_s: float
    threads: int
    open_files: int


def process_figures(pid: int) -> ProcessFigures | None:
    """Look at a process; None when it has ended.

    Args:
        pid: its id.
    """
    home = Path("/proc") / str(pid)
    try:
        fields = (home / "stat").read_text().rpartition(")")[2].split()
        open_files = len(os.listdir(home / "fd"))  # noqa: PTH208 - names only, and quickly
    except OSError:
        return None
    return ProcessFigures(
        resident_bytes=int(fields[_RESIDENT_PAGES]) * PAGE_BYTES,
        cpu_s=(int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])) / TICKS_HZ,
        threads=int(fields[_THREADS]),
        open_files=open_files,
    )
