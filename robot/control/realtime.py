"""Real-time scheduling of the arm process: priority, locked memory, and no garbage collection."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import resource
from typing import NamedTuple

log = logging.getLogger("armbridge.arm")

# Lowest priority of its class: above every ordinary process, below the kernel's own threads.
REAL_TIME_PRIORITY = 1

# Tried where real-time priority is not permitted.
NICENESS = -10

# Flags of mlockall(2) on x86 and ARM (linux/mman.h): present mappings, future ones, and each page at its first use.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4

# Least RLIMIT_MEMLOCK under which memory is locked. All that the process maps counts against it, whether it is used or
# not: 180 MB at its start, 36 of them used.
MIN_LOCKABLE_BYTES = 1 << 30


class Scheduling(NamedTuple):
    """Protection of the loop's ticks against the rest of the machine."""

    real_time: bool = False
    memory_locked: bool = False


def enter_realtime() -> Scheduling:
    """Request real-time priority, and with it locked memory, and switch garbage collection off.

    A collection in the middle of a motion would delay ticks; the loop makes no reference cycles.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    real_time = take_priority()
    return Scheduling(real_time, real_time and lock_memory())


def lock_memory() -> bool:
    """Keep the process's memory from being swapped out; return True if it is kept, log why not.

    A page that must first be read from a disk makes a tick late by milliseconds. A limit that is reached later would
    make an allocation fail in the middle of a motion, so memory is not locked under a low one.
    """
    limit_bytes, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit_bytes != resource.RLIM_INFINITY and limit_bytes < MIN_LOCKABLE_BYTES:
        log.info("memory is not locked: RLIMIT_MEMLOCK is %d bytes, less than %d", limit_bytes, MIN_LOCKABLE_BYTES)
        return False
    import ctypes  # 10 ms of a start that needs it only here

    if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT):
        log.info("memory is not locked: mlockall: %s", os.strerror(ctypes.get_errno()))
        return False
    return True


def take_priority() -> bool:
    """Request real-time priority, else a low niceness; return True if it is real-time."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        return True
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    return False
