"""The planner processes of this machine: started, and replaced when they end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Coroutine
from typing import Any

from planners.worker_process import WorkerProcess
from robot.description.model import RobotModel

log = logging.getLogger("armbridge.planners")

# A worker imports its libraries in half a second; a loaded machine may take many times that.
LOAD_TIMEOUT_S = 30.0

# After so many failed starts in a row there is a pause before each further one.
MAX_FAILED_STARTS = 3
RESTART_PAUSE_S = 5.0

# Processes that were being ended when the pool closed are gone within milliseconds.
CLOSE_TIMEOUT_S = 2.0


class LocalWorkers:
    """So many planner processes for one robot, whatever becomes of each.

    Args:
        robot: the arm to plan for.
        count: how many processes.
        memory_limit_bytes: what each may use for data.
        on_ready: called with each that is ready for requests.
        on_failure: called when :attr:`load_failure` has become known.

    Attributes:
        load_failure: why there is no worker and probably never will be; None as long as one may come.
    """

    def __init__(
        self,
        robot: RobotModel,
        count: int,
        memory_limit_bytes: int,
        on_ready: Callable[[WorkerProcess], None],
        on_failure: Callable[[], None],
    ) -> None:
        self._robot = robot
        self._count = count
        self._memory_limit_bytes = memory_limit_bytes
        self._on_ready = on_ready
        self._on_failure = on_failure
        self._workers: list[WorkerProcess] = []
        self._failed_starts = 0
        self._ever_loaded = False
        self._robot_refused = False
        self._closing = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self.load_failure: str | None = None

    async def start(self) -> None:
        """Start the processes; they load in the background."""
        for _ in range(self._count):
            await self._spawn()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids."""
        return tuple(worker.pid for worker in self._workers)

    @property
    def loaded_count(self) -> int:
        """How many have loaded the robot."""
        return sum(worker.loaded for worker in self._workers)

    async def close(self) -> None:
        """End every process."""
        self._closing.set()
        await asyncio.gather(*(worker.kill() for worker in self._workers))
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_TIMEOUT_S)

    async def _spawn(self) -> None:
        worker = WorkerProcess(self._robot, self._memory_limit_bytes, self._on_loaded, self._on_exit)
        self._workers.append(worker)
        asyncio.get_running_loop().call_later(LOAD_TIMEOUT_S, self._end_unless_loaded, worker)
        await worker.start()

    def _end_unless_loaded(self, worker: WorkerProcess) -> None:
        if not worker.loaded and not self._closing.is_set():
            self._in_background(worker.kill())

    def _on_loaded(self, worker: WorkerProcess, refusal: str | None) -> None:
        if refusal is None:
            self._failed_starts, self._ever_loaded, self.load_failure = 0, True, None
            self._on_ready(worker)
            return
        log.error("planner process cannot load the robot: %s", refusal)
        self._robot_refused, self.load_failure = True, refusal
        self._on_failure()

    def _on_exit(self, worker: WorkerProcess) -> None:
        self._workers.remove(worker)
        if self._closing.is_set() or self._robot_refused:
            return
        if not worker.loaded:
            self._count_failed_start("ended while starting")
        self._in_background(self._replace(worker))

    async def _replace(self, worker: WorkerProcess) -> None:
        await worker.kill()
        log.warning("planner process %d ended (%s); starting another", worker.pid, worker.ending)
        await self._pause_after_failed_starts()
        while not self._closing.is_set():
            try:
                await self._spawn()
            except OSError as error:
                self._count_failed_start(f"could not be started: {error}")
                await self._pause_after_failed_starts()
            else:
                break

    async def _pause_after_failed_starts(self) -> None:
        if self._failed_starts >= MAX_FAILED_STARTS:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), RESTART_PAUSE_S)

    def _count_failed_start(self, problem: str) -> None:
        self._failed_starts += 1
        if self._failed_starts < MAX_FAILED_STARTS:
            return
        message = f"planner processes {problem}, {self._failed_starts} times in a row"
        log.error("%s; the next try is in %g s", message, RESTART_PAUSE_S)
        if not self._ever_loaded:
            # Where one has loaded another will: then requests wait for it.
            self.load_failure = message
            self._on_failure()

    def _in_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
