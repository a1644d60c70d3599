"""The process that drives the arm, as :class:`robot.arm.Arm` sees it: it must hear of its arm before anything else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robot.messages import ArmConfig, Command, Shutdown
from robot.processes import Child, StartedChild

# Orders that come before the process knows its arm are kept for it; it takes a fraction of a second.
MAX_EARLY_ORDERS = 16


def start_arm_process() -> StartedChild:
    """Start a process that can drive an arm; it loads, and waits to be told which."""
    return StartedChild("robot.control.loop")


class ArmProcess:
    """One process after the other.

    Args:
        on_message: called in the event loop with every message of the process.
        on_exit: called in the event loop when a process is gone.
        started: the first process, if it was started ahead.
    """

    def __init__(
        self,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
        started: StartedChild | None = None,
    ) -> None:
        self._started = started
        self._on_message = on_message
        self._on_exit = on_exit
        self._child: Child | None = None
        self._configured = False
        self._early: list[Command] = []

    @property
    def pid(self) -> int | None:
        """Process id."""
        return None if self._child is None else self._child.pid

    @property
    def launched(self) -> bool:
        """Whether there has been a process."""
        return self._child is not None

    @property
    def drives(self) -> bool:
        """Whether a process runs that knows its arm."""
        return self._configured and self._runs()

    async def launch(self) -> None:
        """Start a process, which does nothing before it is configured."""
        started, self._started = self._started or start_arm_process(), None
        self._child = Child(started, on_message=self._on_message, on_exit=self._exited)
        await self._child.connect()

    def configure(self, config: ArmConfig) -> None:
        """Tell the process of its arm, and of the orders that came before; nothing happens when it has ended."""
        if self._child is None or not self._runs():
            return
        self._configured = True
        self._child.send(config)
        early, self._early = self._early, []
        for command in early:
            self._child.send(command)

    def send(self, message: object) -> None:
        """Send a message; lost when no process knows its arm."""
        if self._child is not None and self._configured:
            self._child.send(message)

    def order(self, command: Command) -> bool:
        """Send an order, or keep it for a process that is not configured yet; says whether somebody sees to it."""
        if not self._runs() or (not self._configured and len(self._early) >= MAX_EARLY_ORDERS):
            return False
        if self._configured:
            self.send(command)
        else:
            self._early.append(command)
        return True

    async def end(self, timeout_s: float) -> None:
        """Have the process bring the arm to its end state and end; by force after ``timeout_s``."""
        if self._child is None:
            return
        if self._configured:
            self._child.send(Shutdown())
            await self._child.wait(timeout_s)
        else:
            await self._child.kill()

    async def kill(self) -> None:
        """End the process at once."""
        if self._child is not None:
            await self._child.kill()

    def _runs(self) -> bool:
        return self._child is not None and self._child.running

    def _exited(self) -> None:
        self._configured = False
        self._early.clear()
        self._on_exit()
