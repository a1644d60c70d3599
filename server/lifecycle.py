"""Life of the server: features start in order and stop in reverse, each within a deadline."""

import asyncio
import logging
import os
import signal
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from robot.messages import ArmHealth, ArmState

log = logging.getLogger("armbridge")

STDIN = 0

# Time that is kept for every later step of the stop, however long the earlier ones take [s].
RESERVED_S = 0.1

# Time of a step from a second signal on [s].
HURRIED_S = 0.2

# Time to tidy up of a step that is cut short [s].
CANCEL_TIMEOUT_S = 0.05


async def nothing() -> None:
    """Start or stop a part for which there is nothing to do."""


@dataclass(frozen=True)
class Part:
    """A step of the start, with its counterpart of the stop; its attributes are explained in :class:`Feature`."""

    name: str
    start: Callable[[], Awaitable[None]] = nothing
    stop: Callable[[], Awaitable[None]] = nothing
    deadline_s: float = 0.1
    beyond_total: bool = False


class DiskThreads(ThreadPoolExecutor):
    """Threads for work that waits for a disk, which may never answer: the end of the event loop waits for none."""

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:  # noqa: ARG002
        """Begin no more work, and leave the work in progress to itself."""
        super().shutdown(wait=False, cancel_futures=cancel_futures)


class Feature:
    """One capability of the server: complete when constructed, started once and stopped once.

    Methods that a feature does not override do nothing. States and health come by the name of their arm; the empty name
    stands for the only arm, or for all arms together.

    Attributes:
        deadline_s: longest time for the stop [s].
        beyond_total: True where the time of its stop does not count towards the total of all.
    """

    name = ""
    deadline_s = 0.1
    beyond_total = False

    async def start(self) -> None:
        """Start; a failure ends the server."""

    async def stop(self) -> None:
        """Stop, also after a start that has failed or was cancelled half-way; cancelled at the deadline."""

    def on_state(self, arm: str, state: ArmState) -> None:
        """Take the latest state of an arm."""

    def on_health(self, arm: str, health: ArmHealth) -> None:
        """Take the latest health of an arm."""

    @property
    def observes_states(self) -> bool:
        """True while the feature needs the states of the arms at their full rate."""
        return False


class BackgroundTask(Feature):
    """Coroutine that runs beside the others from its start to its stop; a failure is logged at once."""

    def __init__(self, name: str, run: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self.name = name
        self._run = run
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        self._task = asyncio.create_task(self._run(), name=self.name)
        self._task.add_done_callback(_log_failure)

    async def stop(self) -> None:
        await end_task(self._task)


async def end_task(task: asyncio.Task[None] | None) -> None:
    """Cancel a task, if there is one, and wait for its end."""
    if task is not None:
        task.cancel()
        await asyncio.wait([task])


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        log.error("%s failed", task.get_name(), exc_info=task.exception())


async def start_in_order(parts: Sequence[Part | Feature], started: list[Part | Feature]) -> None:
    """Start parts in order; ``started`` gets each before its start, so that it is stopped even if that fails."""
    for part in parts:
        started.append(part)
        await part.start()


def stop_signals() -> tuple[asyncio.Event, asyncio.Event]:
    """Return two events: the first SIGINT or SIGTERM sets the first event, any further signal the second."""
    ending, hurry = asyncio.Event(), asyncio.Event()

    def take() -> None:
        (hurry if ending.is_set() else ending).set()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, take)
    return ending, hurry


async def run_until_signal(work: Coroutine[Any, Any, None]) -> bool:
    """Run some work to its end, or until SIGINT or SIGTERM; return True when a signal has ended it."""
    ending, _hurry = stop_signals()
    return not await unless_ended(ending, work, cancel_timeout_s=None)


def on_hangup(
    reload: Callable[[], None], stop: Callable[[], None], is_terminal: Callable[[int], bool] = os.isatty
) -> None:
    """Handle SIGHUP: a service reloads its files, a program stops if its terminal is gone."""
    began_in_terminal = is_terminal(STDIN)

    def handle() -> None:
        (stop if began_in_terminal and not is_terminal(STDIN) else reload)()

    asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, handle)


async def unless_ended(
    ending: asyncio.Event, work: Coroutine[Any, Any, object], cancel_timeout_s: float | None = CANCEL_TIMEOUT_S
) -> bool:
    """Do some work to its end and return True; at the event, cancel it, wait for its end [s], and return False."""
    working, ended = asyncio.create_task(work), asyncio.create_task(ending.wait())
    try:
        await asyncio.wait([working, ended], return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (working, ended):
            task.cancel()
    if working.done():
        working.result()
        return True
    await asyncio.wait([working], timeout=cancel_timeout_s)
    return False


async def stop_in_reverse(
    started: Sequence[Part | Feature],
    total_s: float,
    hurry: asyncio.Event | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Stop each part, the last first, within ``total_s`` or in a hurry; a part that fails does not keep the others."""
    hurry = hurry or asyncio.Event()
    until_s = clock() + total_s
    stopped = [part for part in started if _has_stop(part)]
    for left, part in zip(reversed(range(len(stopped))), reversed(stopped), strict=True):
        began_s = clock()
        if part.beyond_total:
            await _stop(part, part.deadline_s, hurry)
            until_s += clock() - began_s
        else:
            await _stop(part, allowance_s(part.deadline_s, until_s - began_s, left), hurry)


def allowance_s(deadline_s: float, left_s: float, parts_left: int) -> float:
    """Return the time for a stop [s]: its deadline, or the rest of the total less the shares of the parts left."""
    return min(deadline_s, max(RESERVED_S, left_s - RESERVED_S * parts_left))


def _has_stop(part: Part | Feature) -> bool:
    return type(part).stop is not Feature.stop if isinstance(part, Feature) else part.stop is not nothing


async def _stop(part: Part | Feature, allowed_s: float, hurry: asyncio.Event) -> None:
    began_s = time.monotonic()
    stopping = asyncio.create_task(_stop_and_log(part), name=f"stop {part.name}")
    # A hurry before or meanwhile cuts its time short.
    hurried = asyncio.create_task(hurry.wait())
    await asyncio.wait([stopping, hurried], timeout=allowed_s, return_when=asyncio.FIRST_COMPLETED)
    if not stopping.done() and hurry.is_set():
        await asyncio.wait([stopping], timeout=min(HURRIED_S, allowed_s))
    hurried.cancel()
    if not stopping.done():
        stopping.cancel()
        await asyncio.wait([stopping], timeout=CANCEL_TIMEOUT_S)
        log.warning("stopping: %s did not end within %.1f s; going on", part.name, time.monotonic() - began_s)


async def _stop_and_log(part: Part | Feature) -> None:
    try:
        await part.stop()
    except Exception:  # a bug in stopping one part must not keep the others, and the arm, from stopping
        log.exception("stopping: %s failed", part.name)
