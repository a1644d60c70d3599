"""Child processes of the server, as it sees them.

A child is started as ``python -P -m MODULE --fd N`` with a fresh interpreter: it shares no lock, no heap and no random
state with the server, only the socket pair of ``robot.channel``.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, cast

from robot import logs
from robot.channel import Decoder, encode

log = logging.getLogger("armbridge.processes")

# A process that is ended by force is gone in milliseconds, unless its machine is very busy.
KILL_TIMEOUT_S = 5.0

# What is still to be sent to a child that does not read may be lost.
CLOSE_TIMEOUT_S = 1.0

# How often a process that is to end is looked at. No thread waits for it: one that hangs could not be left behind.
POLL_S = 0.005

# Environment variables by which systemd tells a service where and how often it wants to hear of it (sd_notify(3)).
OF_SERVICE_MANAGER = frozenset({"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"})


class StartedChild:
    """A child process that loads while nobody talks to it yet; it ends by itself when this process does.

    Args:
        module: the module whose ``__main__`` is the child.

    Attributes:
        process: the child.
        socket: the server's end of its channel.
        adopted: whether a :class:`Child` talks to it.
    """

    def __init__(self, module: str) -> None:
        self.adopted = False
        self.socket, theirs = socket.socketpair()
        with theirs:
            level = str(logging.getLogger().getEffectiveLevel())
            logging_as = ["--log-level", level, "--log-format", logs.format_in_use(), "--name", module]
            self.process = start_module(module, ["--fd", str(theirs.fileno()), *logging_as], (theirs.fileno(),))

    def close(self) -> None:
        """End the child, which waits for its first message, unless it is adopted."""
        if not self.adopted:
            self.socket.close()
            self.process.kill()
            self.process.wait(KILL_TIMEOUT_S)


class Child:
    """The server's end: one running child process.

    Args:
        started: the child.
        on_message: called in the event loop with every message of the child.
        on_exit: called once in the event loop when the child is gone.
        niceness: added to the child's scheduling niceness.
    """

    def __init__(
        self,
        started: StartedChild,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
        *,
        niceness: int = 0,
    ) -> None:
        self._on_message = on_message
        self._on_exit = on_exit
        started.adopted = True
        self._process, self._socket = started.process, started.socket
        if niceness:
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, self._process.pid, niceness)
        self._link: _Link | None = None

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether the child has not ended."""
        return self._process.poll() is None

    @property
    def ending(self) -> str:
        """How the child ended, or that it has not."""
        code = self._process.poll()
        if code is None:
            return "it still runs"
        return f"exit code {code}" if code >= 0 else signal.Signals(-code).name

    async def connect(self) -> None:
        """Begin to read the child's messages."""
        link = _Link(self._hand_on, self._process, self._on_exit)
        await asyncio.get_running_loop().create_unix_connection(lambda: link, sock=self._socket)
        self._link = link
        logs.follow(self)

    def send(self, message: object) -> None:
        """Queue a message for the child; lost when the child is gone."""
        if self._link is not None:
            self._link.write(encode(message))

    async def wait(self, timeout_s: float) -> None:
        """Wait for the child's end, and end it by force when it takes longer, or the wait is cancelled."""
        try:
            if not await has_ended(self._process, timeout_s):
                self._process.kill()
                await has_ended(self._process, KILL_TIMEOUT_S)
        except asyncio.CancelledError:
            self._process.kill()
            raise
        await self._close()

    async def kill(self) -> None:
        """End the child at once."""
        if self.running:
            self._process.kill()
        await self.wait(KILL_TIMEOUT_S)

    def _hand_on(self, message: Any) -> None:
        try:
            self._on_message(message)
        except Exception:  # a bug in serving one message must not make the server deaf to the child
            log.exception("serving a message of process %d failed", self.pid)

    async def _close(self) -> None:
        if self._link is not None:
            await self._link.close()


class _Link(asyncio.Protocol):
    """The socket of one child. Messages are handed on as they are read: a task would wait for others' turns first.

    Args:
        on_message: gets every message.
        process: the child; ended when what it sends is no message.
        on_end: called once, when the socket is closed from either side.
    """

    def __init__(
        self, on_message: Callable[[Any], None], process: subprocess.Popen[bytes], on_end: Callable[[], None]
    ) -> None:
        self._on_message = on_message
        self._process = process
        self._on_end = on_end
        self._decoder = Decoder()
        self._transport: asyncio.Transport | None = None
        self._ended = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        try:
            messages = self._decoder.feed(data)
        except Exception:  # whatever a broken child sends, its end must be told
            log.exception("process %d sent what is no message, and is ended", self._process.pid)
            self._process.kill()
            self._unlink()
            return
        for message in messages:
            self._on_message(message)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - the base class's signature
        self._ended.set()
        self._on_end()

    def write(self, data: bytes) -> None:
        """Send, unless the child is gone."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    async def close(self) -> None:
        """Close the socket, and wait until the end is told."""
        self._unlink()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._ended.wait(), CLOSE_TIMEOUT_S)

    def _unlink(self) -> None:
        if self._transport is not None:
            self._transport.close()


async def has_ended(process: subprocess.Popen[bytes], timeout_s: float) -> bool:
    """Wait for the end of a process, for ``timeout_s`` at most; returns whether it has ended."""
    until_s = time.monotonic() + timeout_s
    while process.poll() is None:
        if time.monotonic() >= until_s:
            return False
        await asyncio.sleep(POLL_S)
    return True


def start_module(module: str, arguments: list[str], pass_fds: tuple[int, ...]) -> subprocess.Popen[bytes]:
    """Start ``python -P -m MODULE`` in a session of its own, out of reach of the terminal's Ctrl-C.

    ``-P`` keeps a folder named like one of ours in the working directory from being imported instead.
    One BLAS thread: the matrices are tiny, and idle BLAS threads spin on the cores that the servo loop needs. A child
    does not speak to the service manager for the server (sd_notify(3)).
    """
    environment = {name: value for name, value in os.environ.items() if name not in OF_SERVICE_MANAGER}
    return subprocess.Popen(  # noqa: S603 - our own interpreter and module
        [sys.executable, "-P", "-m", module, *arguments],
        pass_fds=pass_fds,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        env={**environment, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )
