"""Socket pair between the server and a child: pickled dataclasses behind a length, never from a client."""

import json
import pickle
import select
import signal
import socket
import struct
import sys
from collections import deque
from typing import Any

from robot import logs
from robot.logs import LineHandler, LoggerLevel

LENGTH = struct.Struct("<I")

# The largest message is a robot with its hulls (250 kB); anything near this bound is a bug.
MAX_MESSAGE_BYTES = 64 << 20

# Queue of a child for a server that does not read: 100 arm states of 1 kB, a second of motion.
MAX_PENDING_BYTES = 128 << 10

READ_BYTES = 64 << 10

MAX_PASSED = 1  # descriptors of one message

# A service manager may send these to all processes of the service; by default they end a process.
SIGNALS_OF_SERVER = (signal.SIGINT, signal.SIGHUP, signal.SIGUSR1)


def encode(message: object) -> bytes:
    payload = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    if len(payload) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message of {len(payload)} bytes is over the limit of {MAX_MESSAGE_BYTES}")
    return LENGTH.pack(len(payload)) + payload


class Decoder:
    """Decoder of a byte stream into messages."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Any]:
        """Return the messages completed by ``data``; raise ValueError for one above :data:`MAX_MESSAGE_BYTES`."""
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
    """Child's end of the socket pair; sending never waits for the server."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._socket.setblocking(False)
        self._decoder = Decoder()
        self._pending = bytearray()
        self._kept: list[Any] = []
        self.closed = False  # True when the server has closed its end, or has died
        self.passed: deque[int] = deque()  # descriptors that have come with messages, in their order

    def fileno(self) -> int:
        return self._socket.fileno()

    def move_to(self, descriptor: int) -> None:
        """Go on with another socket: a forked process has its own, and its log goes there, too."""
        self._socket.close()
        self._socket = socket.socket(fileno=descriptor)
        self._socket.setblocking(False)
        self._decoder, self._pending, self._kept = Decoder(), bytearray(), []
        self.passed.clear()

    def receive(self, timeout_s: float | None) -> list[Any]:
        """Return the messages that arrive within a time, without bound for None; none when the server is gone."""
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
        """Wait for the server's first message; return None when the server went away before it."""
        while not self.closed:
            messages = self.receive(timeout_s=None)
            if messages:
                self._kept = messages[1:]
                return messages[0]
        return None

    def _read(self) -> list[Any]:
        try:
            data, passed, _, _ = socket.recv_fds(self._socket, READ_BYTES, MAX_PASSED)
            self.passed += passed
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.closed = True
            return []
        messages = self._decoder.feed(data)
        for message in messages:
            if isinstance(message, LoggerLevel):
                logs.apply(message)
        return [message for message in messages if not isinstance(message, LoggerLevel)]

    def send(self, message: object, *, droppable: bool = False) -> None:
        """Send without waiting; drop a droppable message while :data:`MAX_PENDING_BYTES` wait for the server."""
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


def send_log(channel: Channel, process: str) -> LineHandler:
    """Send the lines of this process's log to the server as well, as far as it reads, until the handler is closed."""
    return LineHandler(process, lambda line: channel.send(line, droppable=True))


def leave_signals_to_server() -> None:
    """Ignore the signals that a child has no use for; the server has started it with them blocked."""
    for number in SIGNALS_OF_SERVER:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS_OF_SERVER)


def channel_of_child() -> Channel:
    """Open the channel that a child was started with, log as its server does, and leave signals to the server."""
    leave_signals_to_server()
    # Of :class:`robot.processes.StartedChild`.
    started = json.loads(sys.argv[1])
    process = f"{started['name']} of {started['arm']}" if started["arm"] else started["name"]
    logs.configure(started["log_level"], started["log_format"], process, started["arm"])
    channel = Channel(socket.socket(fileno=started["fd"]))
    send_log(channel, process)
    return channel
