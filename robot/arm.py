"""The arm, as the server sees it: a handle on the arm process."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import time
from collections.abc import Callable
from typing import Any

from robot.messages import (
    ArmConfig,
    ArmState,
    Execute,
    Mode,
    MotionEnded,
    Outcome,
    Shutdown,
    Stop,
)
from robot.processes import Child
from robot.trajectory import Trajectory

log = logging.getLogger("armbridge.arm")

# Longer than the arm process itself takes to brake and end.
CLOSE_TIMEOUT_S = 2.5

# A process that dies at once must not be restarted in a tight loop.
RESTART_DELAY_S = 0.5


class Arm:
    """The running arm process; restarted when it dies, with the motion in progress answered.

    Args:
        config: the arm.
        on_state: called in the event loop with every state of the arm.
    """

    def __init__(self, config: ArmConfig, on_state: Callable[[ArmState], None]) -> None:
        self._config = config
        self._on_state = on_state
        self._child: Child | None = None
        self._motions: dict[int, asyncio.Future[MotionEnded]] = {}
        self._ids = itertools.count(1)
        self._closing = False
        self._restart: asyncio.Task[None] | None = None
        self._first_state = asyncio.Event()
        self._state_at_s = time.monotonic()
        self.state = ArmState(time.time(), Mode.DISCONNECTED, (), reason="the arm process is starting")

    async def start(self, timeout_s: float) -> None:
        """Start the process and wait for its first state, connected or not.

        Raises:
            TimeoutError: no state came within ``timeout_s``.
        """
        await self._start_child()
        await asyncio.wait_for(self._first_state.wait(), timeout_s)

    @property
    def pid(self) -> int | None:
        """Process id."""
        return self._child.pid if self._child is not None else None

    @property
    def state_age_s(self) -> float:
        """Time since the last state came [s]."""
        return time.monotonic() - self._state_at_s

    def execute(self, trajectory: Trajectory) -> asyncio.Future[MotionEnded]:
        """Send a trajectory to the arm, at once and in order with :meth:`stop`; the future is its one end."""
        motion_id = next(self._ids)
        ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
        if self._child is None or not self._child.running:
            ended.set_result(MotionEnded(motion_id, Outcome.PROCESS_LOST, "the arm process is not running"))
            return ended
        self._motions[motion_id] = ended
        ended.add_done_callback(lambda _: self._motions.pop(motion_id, None))
        self._child.send(Execute(motion_id, trajectory))
        return ended

    def stop(self) -> None:
        """Brake along the path of the motion in progress, if any."""
        if self._child is not None:
            self._child.send(Stop())

    async def close(self) -> None:
        """Brake the arm and end the process."""
        self._closing = True
        if self._restart is not None:
            self._restart.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._restart
        if self._child is not None:
            self._child.send(Shutdown())
            await self._child.wait(CLOSE_TIMEOUT_S)

    async def _start_child(self) -> None:
        self._child = Child("robot.loop", on_message=self._received, on_exit=self._exited)
        await self._child.connect()
        self._child.send(self._config)

    def _received(self, message: Any) -> None:
        if isinstance(message, ArmState):
            self.state = message
            self._state_at_s = time.monotonic()
            self._first_state.set()
            self._on_state(message)
        elif isinstance(message, MotionEnded):
            waiting = self._motions.get(message.motion_id)
            if waiting is not None and not waiting.done():
                waiting.set_result(message)

    def _exited(self) -> None:
        if self._closing:
            return
        log.error("the arm process ended; starting it again")
        self.state = ArmState(time.time(), Mode.DISCONNECTED, (), reason="the arm process ended and is starting again")
        for motion_id, waiting in list(self._motions.items()):
            if not waiting.done():
                waiting.set_result(
                    MotionEnded(motion_id, Outcome.PROCESS_LOST, "the arm process ended during the motion")
                )
        self._restart = asyncio.create_task(self._start_again(), name="restart arm process")

    async def _start_again(self) -> None:
        if self._child is not None:
            await self._child.kill()
        await asyncio.sleep(RESTART_DELAY_S)
        await self._start_child()
