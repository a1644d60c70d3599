"""Supervisor of forked processes: each that ends is started again, and all end together.

This process has no threads and no event loop, so that a fork of it is whole at any time. It waits for signals: the end
of a child (SIGCHLD), or its own (SIGINT, SIGTERM). What it has loaded before the first fork is in memory once for all.
"""

import gc
import logging
import os
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robot.processes import ForkedProcess, RestartDelay
from robot.template import end_with_parent

log = logging.getLogger("armbridge.classroom")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)

# A server takes 2.6 s at most, and the end of its arm up to 20 s where it is parked; twenty of them share the cores.
END_TIMEOUT_S = 40.0

# Interval of looking for what has nothing to do with signals.
CHECK_S = 0.2


@dataclass
class Member:
    """A process that is to run; its log goes to a file, empty at its first start, or to the terminal."""

    name: str
    run: Callable[[], None]
    log_file: Path | None = None
    _process: ForkedProcess | None = None
    _started_s: float = 0.0
    _due_s: float = 0.0
    _delay: RestartDelay = field(default_factory=RestartDelay)
    _starts: int = 0

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start_if_due(self, now_s: float) -> None:
        if self._process is not None or now_s < self._due_s:
            return
        self._started_s = now_s
        self._starts += 1
        try:
            self._process = ForkedProcess(self._be)
        except OSError as error:
            self._due_s = now_s + self._delay.after(0.0)
            log.warning("%s cannot be started: %s", self.name, error)
        else:
            log.info("%s: process %d", self.name, self._process.pid)

    def reap(self, now_s: float) -> None:
        """Notice the end of the process; it becomes due again, later each time."""
        if self._process is None or (code := self._process.poll()) is None:
            return
        self._process = None
        delay_s = self._delay.after(now_s - self._started_s)
        self._due_s = now_s + delay_s
        ending = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        log.warning("%s has ended (%s) and is started again in %.1f s", self.name, ending, delay_s)

    def ended(self) -> bool:
        return self._process is None or self._process.poll() is not None

    def signal(self, number: signal.Signals) -> None:
        if self._process is not None and not self.ended():
            os.kill(self._process.pid, number)

    def _be(self) -> None:
        end_with_parent(os.getppid(), signal.SIGTERM)
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        if self.log_file is not None:
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | (os.O_TRUNC if self._starts == 1 else 0)
            descriptor = os.open(self.log_file, flags, 0o600)
            for standard in (1, 2):
                os.dup2(descriptor, standard)
            os.close(descriptor)
        self.run()


def supervise(members: Sequence[Member], check: Callable[[], None]) -> None:
    """Run all members until SIGINT or SIGTERM; then end them together."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    # A collection in a child would write to every object, and so copy what it shares with the others.
    gc.collect()
    gc.freeze()
    try:
        while not _told_to_end():
            now_s = time.monotonic()
            for member in members:
                member.reap(now_s)
                member.start_if_due(now_s)
            check()
    finally:
        _end(members)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _told_to_end() -> bool:
    """Wait for a signal, for a while; return True when it asks for the end."""
    received = signal.sigtimedwait(SIGNALS, CHECK_S)
    return received is not None and received.si_signo != signal.SIGCHLD


def _end(members: Iterable[Member]) -> None:
    """End all members: in good order, at once after a second signal, and by force when they take too long."""
    running = [member for member in members if not member.ended()]
    for member in running:
        member.signal(signal.SIGTERM)
    until_s = time.monotonic() + END_TIMEOUT_S
    while (running := [member for member in running if not member.ended()]) and time.monotonic() < until_s:
        if _told_to_end():
            for member in running:
                member.signal(signal.SIGTERM)
    for member in running:
        log.warning("%s does not end and is killed", member.name)
        member.signal(signal.SIGKILL)
