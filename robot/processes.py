"""Child processes from the server's side: fresh interpreters that share only the sockets of :mod:`robot.channel`."""

import asyncio
import contextlib
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn, TypeAlias, cast

from robot import logs
from robot.channel import SIGNALS_OF_SERVER, Decoder, encode
from robot.logs import LogLine
from robot.template import Copied, Copy, CopyEnded, Ready

log = logging.getLogger("armbridge.processes")

KILL_TIMEOUT_S = 5.0  # a killed process is gone in milliseconds, unless the machine is very busy
LAST_MESSAGES_S = 0.3  # reading what waits in a socket takes a millisecond; a descendant of the child may keep it open
ENDING_TIMEOUT_S = 1.0  # a process whose socket is closed is about to end; its exit code comes a moment later
CLOSE_TIMEOUT_S = 1.0  # data still queued for a child that does not read may be lost

# Interval of polling a process that is to end. No thread waits for it: a thread that hangs cannot be abandoned.
POLL_S = 0.005

# Environment variables of systemd's notification protocol (sd_notify(3)).
OF_SERVICE_MANAGER = frozenset({"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"})

# The start of a child takes five: its socket pair, /dev/null, and the pipe by which exec reports its error.
RESERVED_DESCRIPTORS = 8

# Delays before a process is started in place of a process that has ended soon: a tight loop of starts would take a
# core, and memory or descriptors that are used up are back within seconds or not soon. A start takes half a second; a
# process that has run for twice that is replaced at once.
FIRST_RESTART_S = 0.2
LONGEST_RESTART_S = 10.0
SHORT_RUN_S = 1.0


class DescriptorReserve:
    """File descriptors kept for the start of a child: clients that use up all others cannot prevent it."""

    def __init__(self, count: int = RESERVED_DESCRIPTORS) -> None:
        self._count = count
        self._held: list[int] = []

    def fill(self) -> None:
        """Take the descriptors, or as many as are left."""
        with contextlib.suppress(OSError):
            while len(self._held) < self._count:
                self._held.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))

    def close(self) -> None:
        """Give the descriptors back for good."""
        self._count = 0
        self._release()

    @contextlib.contextmanager
    def lent(self) -> Iterator[None]:
        """Give the descriptors back for the time of a start, and take them again."""
        self._release()
        try:
            yield
        finally:
            self.fill()

    def _release(self) -> None:
        while self._held:
            os.close(self._held.pop())


class RestartDelay:
    """Delay before each start of a process: none after a run that was not short, else doubled from start to start."""

    def __init__(self, first_s: float = FIRST_RESTART_S, longest_s: float = LONGEST_RESTART_S) -> None:
        self._first_s = first_s
        self._longest_s = longest_s
        self._next_s = first_s

    def after(self, ran_s: float) -> float:
        """Return the time to wait [s] after a process ran for a time [s]; 0 for a failed start."""
        if ran_s >= SHORT_RUN_S:
            self._next_s = self._first_s
            return 0.0
        delay_s, self._next_s = self._next_s, min(2.0 * self._next_s, self._longest_s)
        return delay_s


class ForkedProcess:
    """Child of ``fork`` in a session of its own, before this process has threads: it shares the loaded memory."""

    def __init__(self, run: Callable[[], None]) -> None:
        self._code: int | None = None
        with _blocked(SIGNALS_OF_SERVER):
            self.pid = os.fork()
            if self.pid == 0:
                _be_child(run)

    def poll(self) -> int | None:
        """Return the exit code, the negative number of a signal; None while it runs."""
        if self._code is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:
                # Waited for elsewhere; how it ended is not known.
                pid, status = self.pid, 0
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code

    def kill(self) -> None:
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)

    def wait(self, timeout: float | None = None) -> int:
        until_s = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until_s is not None and time.monotonic() >= until_s:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            time.sleep(POLL_S)
        return code


def _be_child(run: Callable[[], None]) -> NoReturn:
    code = 1
    try:
        os.setsid()
        run()
        code = 0
    except Exception:
        log.exception("a child process ends")
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


class CopiedProcess:
    """Copy of a template (:mod:`robot.template`), which reports the end of its child: only a parent can wait for it."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, the negative number of a signal; None while it runs."""
        return self.code

    def kill(self) -> None:
        if self.code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


# Process that this one has started, or has had copied.
Process: TypeAlias = subprocess.Popen[bytes] | ForkedProcess | CopiedProcess


class StartedChild:
    """Child started ahead with ``python -m``, which ends with this process; its log lines name an arm.

    With a body to run it is a ``fork``, whose body gets its end of the channel: see :class:`ForkedProcess`.
    """

    def __init__(self, module: str, arm: str = "", body: Callable[[socket.socket], None] | None = None) -> None:
        self.adopted = False  # True once a Child owns it
        ours, theirs = socket.socketpair()
        self.socket = ours
        level, form = logging.getLogger().getEffectiveLevel(), logs.format_in_use()
        fd = theirs.fileno()
        started_as = json.dumps({"fd": fd, "log_level": level, "log_format": form, "name": module, "arm": arm})

        def run() -> None:
            # The server's end would keep the channel open when the server has died.
            ours.close()
            if body is not None:
                body(theirs)

        with theirs:
            try:
                self.process: subprocess.Popen[bytes] | ForkedProcess = (
                    start_module(module, [started_as], (fd,)) if body is None else ForkedProcess(run)
                )
            except BaseException:
                ours.close()
                raise

    def close(self) -> None:
        """Kill the child, unless it is adopted."""
        if not self.adopted:
            self.socket.close()
            self.process.kill()
            self.process.wait(KILL_TIMEOUT_S)


@dataclass
class StartedCopy:
    """Copy of a template, and the server's end of its channel."""

    process: CopiedProcess
    socket: socket.socket
    adopted: bool = False  # True once a Child owns it


ENDED_IN_ORDER = "exit code 0"


class Child(asyncio.Protocol):
    """Running child, and the server's end of its channel; messages are delivered as they are read, without a task."""

    def __init__(
        self,
        started: StartedChild | StartedCopy,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
        *,
        niceness: int = 0,
    ) -> None:
        self._on_message = on_message
        self._on_exit = on_exit
        started.adopted = True
        self._process: Process = started.process
        self._socket = started.socket
        self._decoder = Decoder()
        self._transport: asyncio.Transport | None = None
        self._ended = asyncio.Event()
        if niceness:
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, self._process.pid, niceness)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    @property
    def ending(self) -> str:
        """Exit code or signal of the child, as text."""
        code = self._process.poll()
        if code is None:
            return "it still runs"
        return ENDED_IN_ORDER if code == 0 else f"exit code {code}" if code > 0 else signal.Signals(-code).name

    async def connect(self) -> None:
        """Begin to read the child's messages; a child that cannot be read is killed."""
        try:
            await asyncio.get_running_loop().create_unix_connection(lambda: self, sock=self._socket)
        except BaseException:
            self._process.kill()
            self._socket.close()
            await has_ended(self._process, KILL_TIMEOUT_S)
            raise
        logs.follow(self)

    def send(self, message: object) -> None:
        """Queue a message for the child; dropped before :meth:`connect` and after the child's end."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(encode(message))

    def send_socket(self, message: object, passed: socket.socket) -> None:
        """Send a message, and a socket for the child to use as well; OSError: the child does not read."""
        if self._transport is None or self._transport.is_closing() or self._transport.get_write_buffer_size():
            raise OSError(f"process {self.pid} does not read what it is sent")
        socket.send_fds(self._socket, [encode(message)], [passed.fileno()])

    async def wait(self, timeout_s: float) -> None:
        """Wait for the child's end and last messages; kill it after ``timeout_s``, or when the wait is cancelled."""
        try:
            if not await has_ended(self._process, timeout_s):
                log.warning("process %d has not ended within %g s and is killed", self.pid, timeout_s)
                self._process.kill()
                await has_ended(self._process, KILL_TIMEOUT_S)
        except asyncio.CancelledError:
            self._process.kill()
            raise
        if self._transport is None:
            return
        # The child's end ends the socket too, behind its last message.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._ended.wait(), LAST_MESSAGES_S)
        self._transport.close()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._ended.wait(), CLOSE_TIMEOUT_S)

    async def kill(self) -> None:
        if self.running:
            self._process.kill()
        await self.wait(KILL_TIMEOUT_S)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        """Deliver the messages completed by ``data``; kill a child that sends anything else."""
        try:
            messages = self._decoder.feed(data)
        except Exception:  # unpickling may raise anything; the end must be reported all the same
            log.exception("process %d sent bytes that are no message, and is ended", self.pid)
            self._process.kill()
            if self._transport is not None:
                self._transport.close()
            return
        for message in messages:
            if isinstance(message, LogLine):
                logs.pass_on(message)
            else:
                self._deliver(message)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - the base class's signature
        self._ended.set()
        self._on_exit()

    def _deliver(self, message: Any) -> None:
        try:
            self._on_message(message)
        except Exception:  # a bug in handling one message must not close the channel
            log.exception("serving a message of process %d failed", self.pid)


class RunningTemplate:
    """Template from its start to its end."""

    def __init__(self, started: StartedChild) -> None:
        self.child = Child(started, self._received, self._exited)
        self._copies: dict[int, CopiedProcess] = {}
        # Answers; None stands for the child's end.
        self._ready: asyncio.Future[Ready | None] = asyncio.get_running_loop().create_future()
        self._copied: asyncio.Future[CopiedProcess | None] = asyncio.get_running_loop().create_future()

    async def copy(self, reserve: DescriptorReserve) -> StartedCopy:
        with contextlib.ExitStack() as unless_copied:
            if await asyncio.shield(self._ready) is not None:
                with reserve.lent():
                    ours, theirs = socket.socketpair()
                unless_copied.callback(ours.close)
                with theirs:
                    self.child.send_socket(Copy(), theirs)
                process = await self._copied
                self._copied = asyncio.get_running_loop().create_future()
                if process is not None:
                    unless_copied.pop_all()
                    return StartedCopy(process, ours)
        await self.child.wait(ENDING_TIMEOUT_S)
        raise OSError(f"the process that is copied ended ({self.child.ending})")

    def _received(self, message: Any) -> None:
        match message:
            case Ready():
                self._ready.set_result(message)
            case Copied(pid):
                process = self._copies[pid] = CopiedProcess(pid)
                self._copied.set_result(process)
            case CopyEnded(pid, code):
                self._copies.pop(pid).code = code

    def _exited(self) -> None:
        for process in self._copies.values():
            process.kill()
            process.code = -signal.SIGKILL
        for answer in (self._ready, self._copied):
            if not answer.done():
                answer.set_result(None)


class Template:
    """Child that is copied (:mod:`robot.template`), a module's ``main``; when it has ended a copy starts it again.

    Args:
        first_message: what the child loads from.
        reserve: lends the descriptors that a start and a copy take.
        timeout_s: time that loading may take [s].
    """

    def __init__(self, module: str, first_message: object, reserve: DescriptorReserve, timeout_s: float) -> None:
        self._module, self._first_message = module, first_message
        self._reserve, self._timeout_s = reserve, timeout_s
        self._turns = asyncio.Lock()
        self._running: RunningTemplate | None = None
        self._closed = False

    async def start(self) -> RunningTemplate:
        """Start the child, which loads; OSError: it cannot be started, or was closed."""
        if self._closed:
            raise OSError("nothing is copied any more")
        with self._reserve.lent():
            running = self._running = RunningTemplate(StartedChild(self._module))
        await running.child.connect()
        running.child.send(self._first_message)
        return running

    async def copy(self) -> StartedCopy:
        """Return a new copy, once the child has loaded; OSError: it has ended, or does not answer in time."""
        async with self._turns:
            running = self._running
            if running is None or not running.child.running:
                running = await self.start()
            try:
                async with asyncio.timeout(self._timeout_s):
                    return await running.copy(self._reserve)
            except (TimeoutError, asyncio.CancelledError) as error:
                # What it may still answer would be taken for the next answer.
                await running.child.kill()
                if isinstance(error, TimeoutError):
                    raise OSError(f"the process that is copied did not answer within {self._timeout_s:g} s") from error
                raise

    async def close(self) -> None:
        """End the child for good, and with it every copy."""
        self._closed = True
        if self._running is not None:
            await self._running.child.kill()


async def has_ended(process: Process, timeout_s: float) -> bool:
    """Wait for the end of a process, for ``timeout_s`` at most; return True when it has ended."""
    until_s = time.monotonic() + timeout_s
    while process.poll() is None:
        if time.monotonic() >= until_s:
            return False
        await asyncio.sleep(POLL_S)
    return True


def start_module(module: str, arguments: list[str], pass_fds: tuple[int, ...]) -> subprocess.Popen[bytes]:
    """Start ``python -P -m MODULE`` in a session of its own, out of reach of the terminal's Ctrl-C.

    Its ``main`` opens the channel (:func:`robot.channel.channel_of_child`). ``-P`` keeps a folder of the working
    directory with the name of one of our packages from being imported. One BLAS thread: the matrices are tiny, and idle
    BLAS threads spin on the cores that the servo loop needs. The child does not inherit the service manager's
    notification socket (sd_notify(3)).
    """
    environment = {name: value for name, value in os.environ.items() if name not in OF_SERVICE_MANAGER}
    with _blocked(SIGNALS_OF_SERVER):
        return subprocess.Popen(  # noqa: S603 - our own interpreter and module
            [sys.executable, "-P", "-m", module, *arguments],
            pass_fds=pass_fds,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env={**environment, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )


@contextlib.contextmanager
def _blocked(signals: Collection[signal.Signals]) -> Iterator[None]:
    """Have a child begin with signals blocked, until it ignores them.

    A child takes half a second to get there, and until then a service manager's signal, meant for the server, would end
    it. The mask is inherited through exec (execve(2)); what comes for the server meanwhile is delivered afterwards.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
