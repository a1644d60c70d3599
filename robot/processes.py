"""Child processes of the server and the one socket pair that joins each of them to it.

A child is started as ``python -P -m MODULE --fd N`` with a fresh interpreter: it shares no lock, no heap and no
random state with the server. Both ends exchange pickled dataclasses behind a four-byte length; both ends are this
program's own, nothing from a client is ever unpickled. A child whose socket closes has lost its server.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import pickle
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from typing import Any

log = logging.getLogger("armbridge.processes")

# Of the server and its children alike: they share one terminal.
LOG_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"

LENGTH = struct.Struct("<I")

# The largest message is a robot with its hulls (250 kB); anything near this bound is a bug.
MAX_MESSAGE_BYTES = 64 << 20

# What a child keeps for a server that does not read: 100 arm states of 1 kB, a second of motion.
MAX_PENDING_BYTES = 128 << 10

READ_BYTES = 64 << 10


def encode(message: object) -> bytes:
    """Frame one message for the other end.

    Raises:
        ValueError: it is larger than the other end takes.
    """
    payload = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    if len(payload) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message of {len(payload)} bytes is over the limit of {MAX_MESSAGE_BYTES}")
    return LENGTH.pack(len(payload)) + payload


class Decoder:
    """Takes bytes as they come and gives whole messages."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Any]:
        """Return the messages completed by ``data``."""
        self._buffer += data
        messages = []
        while len(self._buffer) >= LENGTH.size:
            (size,) = LENGTH.unpack_from(self._buffer)
            if size > MAX_MESSAGE_BYTES:
                raise ValueError(f"a message of {size} bytes is over the limit of {MAX_MESSAGE_BYTES}")
            end = LENGTH.size + size
            if len(self._buffer) < end:
                break
            messages.append(pickle.loads(self._buffer[LENGTH.size : end]))  # noqa: S301 - our own process
            del self._buffer[:end]
        return messages


class Channel:
    """A child's end of the pair: never waits for the server, and notices its death."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._socket.setblocking(False)
        self._decoder = Decoder()
        self._pending = bytearray()
        self._kept: list[Any] = []
        self.closed = False

    def fileno(self) -> int:
        """File descriptor, for ``select``."""
        return self._socket.fileno()

    def receive(self, timeout_s: float | None) -> list[Any]:
        """Messages that arrive within ``timeout_s`` (None: wait); empty when none came or the server is gone."""
        if self._kept:
            kept, self._kept = self._kept, []
            return kept
        while not self.closed:
            self._flush()
            writing = [self._socket] if self._pending else []
            readable, writable, _ = select.select([self._socket], writing, [], timeout_s)
            if readable:
                return self._read()
            if not writable:
                break
        return []

    def receive_first(self) -> Any:
        """Wait for the server's first message; None when the server went away before it."""
        while not self.closed:
            messages = self.receive(timeout_s=None)
            if messages:
                self._kept = messages[1:]
                return messages[0]
        return None

    def _read(self) -> list[Any]:
        try:
            data = self._socket.recv(READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.closed = True
            return []
        return self._decoder.feed(data)

    def send(self, message: object, *, droppable: bool = False) -> None:
        """Send without waiting; a droppable message is dropped while the server does not read."""
        self._flush()
        if droppable and len(self._pending) > MAX_PENDING_BYTES:
            return
        self._pending += encode(message)
        self._flush()

    def _flush(self) -> None:
        while self._pending and not self.closed:
            try:
                sent = self._socket.send(self._pending)
            except BlockingIOError:
                return
            except OSError:
                self.closed = True
                return
            del self._pending[:sent]


def channel_of_child(arguments: list[str] | None = None) -> Channel:
    """Open the channel a child was started with, and log as its server does.

    Ctrl-C is the server's to handle, never the child's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parser = argparse.ArgumentParser()
    parser.add_argument("--fd", type=int, required=True)
    parser.add_argument("--log-level", type=int, default=logging.INFO)
    options = parser.parse_args(arguments)
    logging.basicConfig(level=options.log_level, format=LOG_FORMAT)
    return Channel(socket.socket(fileno=options.fd))


class Child:
    """The server's end: one running child process.

    Args:
        module: the module whose ``__main__`` is the child.
        on_message: called in the event loop with every message of the child.
        on_exit: called once in the event loop when the child is gone.
        niceness: added to the child's scheduling niceness.
    """

    def __init__(
        self,
        module: str,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
        *,
        niceness: int = 0,
    ) -> None:
        self._on_message = on_message
        self._on_exit = on_exit
        ours, theirs = socket.socketpair()
        with theirs:
            arguments = ["--fd", str(theirs.fileno()), "--log-level", str(logging.getLogger().getEffectiveLevel())]
            self._process = start_module(module, arguments, (theirs.fileno(),))
        self._socket = ours
        if niceness:
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, self._process.pid, niceness)
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None

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
        reader, self._writer = await asyncio.open_unix_connection(sock=self._socket)
        self._reading = asyncio.create_task(self._read(reader), name=f"read child {self.pid}")

    def send(self, message: object) -> None:
        """Queue a message for the child; lost when the child is gone."""
        if self._writer is not None and not self._writer.is_closing():
            self._writer.write(encode(message))

    async def wait(self, timeout_s: float) -> None:
        """Wait for the child's end, and end it by force when it takes longer."""
        try:
            await asyncio.wait_for(asyncio.to_thread(self._process.wait, timeout_s), timeout_s + 1.0)
        except (subprocess.TimeoutExpired, TimeoutError):
            self._process.kill()
            await asyncio.to_thread(self._process.wait, 5.0)
        await self._close()

    async def kill(self) -> None:
        """End the child at once."""
        if self.running:
            self._process.kill()
        await self.wait(5.0)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        decoder = Decoder()
        try:
            while data := await reader.read(READ_BYTES):
                for message in decoder.feed(data):
                    self._hand_on(message)
        except ConnectionError:
            pass
        except Exception:  # whatever a broken child sends, its end must be told
            log.exception("process %d sent what is no message, and is ended", self.pid)
            self._process.kill()
        self._on_exit()

    def _hand_on(self, message: Any) -> None:
        try:
            self._on_message(message)
        except Exception:  # a bug in serving one message must not make the server deaf to the child
            log.exception("serving a message of process %d failed", self.pid)

    async def _close(self) -> None:
        if self._writer is not None:
            self._writer.close()
        if self._reading is not None and self._reading is not asyncio.current_task():
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.wait_for(self._reading, 1.0)


def start_module(module: str, arguments: list[str], pass_fds: tuple[int, ...]) -> subprocess.Popen[bytes]:
    """Start ``python -P -m MODULE`` in a session of its own, out of reach of the terminal's Ctrl-C.

    ``-P`` keeps a folder named like one of ours in the working directory from being imported instead.
    One BLAS thread: the matrices are tiny, and idle BLAS threads spin on the cores that the servo loop needs.
    """
    return subprocess.Popen(  # noqa: S603 - our own interpreter and module
        [sys.executable, "-P", "-m", module, *arguments],
        pass_fds=pass_fds,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )
