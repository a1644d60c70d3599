"""Files that several processes may change: locked against each other by flock(2), and replaced as a whole.

The lock of a file is ``.NAME.lock`` beside it, with the number of the process that locked it last. The lock's file
stays, since removing it would let two processes lock two files of one name.
"""

import contextlib
import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

# A process writes a file in milliseconds, on a memory card in some tenths of a second.
LOCK_TIMEOUT_S = 2.0
LOCK_POLL_S = 0.02

MAX_HOLDER_BYTES = 200  # a process's name and number fit; more is nothing of ours


class FileLockedError(OSError):
    """Another process has the lock of a file; ``strerror`` names the process."""

    def __init__(self, path: Path, holder: str) -> None:
        super().__init__(errno.EAGAIN, f"is in use by {holder}", str(path))


class FileLock:
    """Lock of a file that need not exist; one at a time has it, in this process and all others."""

    def __init__(self, path: Path) -> None:
        self._path = lock_path(path)
        self._descriptor: int | None = None

    def acquire(self, timeout_s: float = 0.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Take the lock, after a wait of ``timeout_s`` at most; raises FileLockedError, and OSError without locks."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            self._wait(descriptor, timeout_s, clock)
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"armbridge (process {os.getpid()})\n".encode(), 0)
        except BaseException:
            os.close(descriptor)
            raise
        self._descriptor = descriptor

    def _wait(self, descriptor: int, timeout_s: float, clock: Callable[[], float]) -> None:
        until_s = clock() + timeout_s
        while not _locked(descriptor):
            if clock() >= until_s:
                holder = os.pread(descriptor, MAX_HOLDER_BYTES, 0).decode(errors="replace").strip()
                raise FileLockedError(self._path, holder or "another process")
            time.sleep(LOCK_POLL_S)

    def release(self) -> None:
        """Give the lock back; do nothing without it."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


@contextlib.contextmanager
def locked(path: Path, timeout_s: float | None = None) -> Iterator[None]:
    """Hold the lock of a file; raises FileLockedError after a wait, None for :data:`LOCK_TIMEOUT_S`."""
    lock = FileLock(path)
    lock.acquire(LOCK_TIMEOUT_S if timeout_s is None else timeout_s)
    try:
        yield
    finally:
        lock.release()


def replace(path: Path, content: bytes, mode: int | None = None) -> None:
    """Write a locked file as a whole, through symbolic links; a crash leaves the old content or the new one."""
    path = path.resolve()
    unfinished = path.with_name(f".{path.name}.new")
    try:
        unfinished.unlink(missing_ok=True)
        with unfinished.open("xb") as file:
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise
    _sync_directory(path.parent)


def lock_path(path: Path) -> Path:
    """Return the path of a file's lock; all names of one file have the same."""
    resolved = path.resolve()
    return resolved.with_name(f".{resolved.name}.lock")


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _sync_directory(path: Path) -> None:
    """Make the renaming of a file in a directory outlive a loss of power, where the file system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
