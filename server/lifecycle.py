"""The end of the server: one step after the other, each with a deadline, so that what hangs holds nothing else up."""

from __future__ import annotations

import asyncio
import logging
import signal
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass
from typing import Any

log = logging.getLogger("armbridge")

# What every later step is left, however long those before it take.
RESERVED_S = 0.1

# What a step gets from a second signal on.
HURRIED_S = 0.2

# A step that is cut short may tidy up for so long.
CANCEL_TIMEOUT_S = 0.05


@dataclass(frozen=True)
class Step:
    """One part that ends.

    Attributes:
        name: as the log calls it.
        end: ends it; cancelled at its deadline.
        deadline_s: what it may take [s].
    """

    name: str
    end: Callable[[], Awaitable[None]]
    deadline_s: float


def stop_signals() -> tuple[asyncio.Event, asyncio.Event]:
    """Events that SIGINT and SIGTERM set: the first one the first, any further one the second."""
    ending, hurry = asyncio.Event(), asyncio.Event()

    def take() -> None:
        (hurry if ending.is_set() else ending).set()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, take)
    return ending, hurry


async def unless_ended(ending: asyncio.Event, starting: Coroutine[Any, Any, None]) -> bool:
    """Start, unless the end comes before that is done; says whether it is."""
    started, ended = asyncio.create_task(starting), asyncio.create_task(_until(ending))
    await asyncio.wait([started, ended], return_when=asyncio.FIRST_COMPLETED)
    if started.done():
        ended.cancel()
        started.result()
        return True
    started.cancel()
    await asyncio.wait([started], timeout=CANCEL_TIMEOUT_S)
    return False


async def stop_in_order(
    steps: Sequence[Step],
    total_s: float,
    hurry: asyncio.Event | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Take each step, whatever becomes of those before it.

    Args:
        steps: in their order.
        total_s: what all of them may take together [s].
        hurry: set by who will not wait; each step then has HURRIED_S.
        clock: monotonic time [s].
    """
    hurry = hurry or asyncio.Event()
    until_s = clock() + total_s
    for after, step in zip(reversed(range(len(steps))), steps, strict=True):
        await _take(step, allowance_s(step.deadline_s, until_s - clock(), after), hurry)


def allowance_s(deadline_s: float, left_s: float, steps_after: int) -> float:
    """What a step gets [s]: its deadline, or what is left of the total when the steps after it have their share.

    Args:
        deadline_s: of the step [s].
        left_s: of the total [s].
        steps_after: how many steps follow.
    """
    return min(deadline_s, max(RESERVED_S, left_s - RESERVED_S * steps_after))


async def _take(step: Step, allowed_s: float, hurry: asyncio.Event) -> None:
    began_s = time.monotonic()
    ending = asyncio.create_task(_contained(step), name=f"stop {step.name}")
    if not await _done_in_time(ending, allowed_s, hurry):
        ending.cancel()
        await asyncio.wait([ending], timeout=CANCEL_TIMEOUT_S)
        log.warning("stopping: %s did not end within %.1f s; going on", step.name, time.monotonic() - began_s)


async def _done_in_time(ending: asyncio.Future[None], allowed_s: float, hurry: asyncio.Event) -> bool:
    """Wait for a step; a hurry that comes meanwhile cuts its time short."""
    hurried = asyncio.create_task(_until(hurry))
    try:
        if not hurry.is_set():
            await asyncio.wait([ending, hurried], timeout=allowed_s, return_when=asyncio.FIRST_COMPLETED)
        if not ending.done() and hurry.is_set():
            await asyncio.wait([ending], timeout=min(HURRIED_S, allowed_s))
        return ending.done()
    finally:
        hurried.cancel()


async def _until(event: asyncio.Event) -> None:
    await event.wait()


async def _contained(step: Step) -> None:
    try:
        await step.end()
    except Exception:  # a bug in ending one part must not keep the others, and the arm, from ending
        log.exception("stopping: %s failed", step.name)
