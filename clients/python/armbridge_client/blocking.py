"""The synchronous face: an event loop on a thread of its own, and methods that wait for its answers.

``move_to = blocking(AsyncArm.move_to)`` in a subclass of `Face` makes a method with the same arguments, documentation
and result, which returns when the coroutine has ended.
"""

from __future__ import annotations

import asyncio
import contextlib
import enum
import functools
import queue
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from types import TracebackType
from typing import Any, Concatenate, Generic, Literal, ParamSpec, Protocol, TypeVar

from armbridge_client.errors import ConnectionLost

A = TypeVar("A")
B = TypeVar("B")
F = TypeVar("F")
T = TypeVar("T")
P = ParamSpec("P")


class _End(enum.Enum):
    """End of an iterator; its values may be anything, None too."""

    END = enum.auto()


# On Windows a wait without a timeout lets no Ctrl-C through.
POLL_S = 0.5
END_TIMEOUT_S = 2.0

_CLOSED = "this client has closed the connection"


class LoopThread:
    """Event loop on a daemon thread; any thread and any signal handler may wait for it."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="armbridge_client", daemon=True)
        self._thread.start()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine to its end; an exception here, such as KeyboardInterrupt, cancels it.

        A signal handler may call this in the middle of another call of the same thread. So this thread never holds a
        lock that the loop's thread takes, as one who waits for a future or an event does: SimpleQueue.put takes none.
        """
        ended: queue.SimpleQueue[asyncio.Task[T] | None] = queue.SimpleQueue()
        begun: list[asyncio.Task[T]] = []

        def begin() -> None:
            begun.append(self._loop.create_task(coroutine))
            begun[0].add_done_callback(ended.put)

        def cancel() -> None:
            if begun:
                begun[0].cancel()
            else:  # interrupted before the loop heard of it
                coroutine.close()
                ended.put(None)

        try:
            try:
                self._loop.call_soon_threadsafe(begin)
            except RuntimeError as error:
                coroutine.close()
                raise ConnectionLost(_CLOSED) from error
            task = self._when_ended(ended)
        except BaseException:  # KeyboardInterrupt, or what a signal handler raises
            with contextlib.suppress(RuntimeError, queue.Empty):
                self._loop.call_soon_threadsafe(cancel)
                # Until the coroutine has ended, its objects are in use.
                ended.get(timeout=END_TIMEOUT_S)
            raise
        if task is None or task.cancelled():
            raise ConnectionLost(_CLOSED)
        return task.result()

    def _when_ended(self, ended: queue.SimpleQueue[asyncio.Task[T] | None]) -> asyncio.Task[T] | None:
        """Wait for a task; None where the thread has ended before."""
        while self._thread.is_alive():
            with contextlib.suppress(queue.Empty):
                return ended.get(timeout=POLL_S)
        return None if ended.empty() else ended.get()

    def end(self) -> None:
        """End the thread and its loop."""
        if self._thread.is_alive() and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(END_TIMEOUT_S)

    def _serve(self) -> None:
        self._loop.run_forever()
        for task in (tasks := asyncio.all_tasks(self._loop)):
            task.cancel()
        if tasks:  # some say good-bye, for which the loop needs all that it has
            self._loop.run_until_complete(asyncio.wait(tasks, timeout=END_TIMEOUT_S / 2))
        self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        self._loop.close()


class Face(Generic[A]):
    """Object whose methods wait for the methods of an asynchronous object."""

    def __init__(self, asynchronous: A, loop: LoopThread) -> None:
        self.asynchronous = asynchronous
        self.loop = loop


class Context(Protocol):
    """Asynchronous context manager."""

    async def __aenter__(self) -> object:
        """Enter."""

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave."""


C = TypeVar("C", bound=Context)
# typing.Self came with Python 3.11.
Entered = TypeVar("Entered", bound="ContextFace[Any]")


class ContextFace(Face[C]):
    """Face of an asynchronous context manager, for the length of a ``with``."""

    def __enter__(self: Entered) -> Entered:
        self.loop.run(self.asynchronous.__aenter__())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.loop.run(self.asynchronous.__aexit__(kind, error, trace))


class blocking(Generic[A, P, T]):  # noqa: N801 - used as a decorator
    """Method that waits for a coroutine of the asynchronous object."""

    def __init__(self, method: Callable[Concatenate[A, P], Coroutine[Any, Any, T]]) -> None:
        self._method = method
        self.__doc__ = method.__doc__

    def __get__(self, face: Face[A], owner: type[Face[A]]) -> Callable[P, T]:
        @functools.wraps(self._method)
        def wait(*arguments: P.args, **named: P.kwargs) -> T:
            return face.loop.run(self._method(face.asynchronous, *arguments, **named))

        return wait


class making(Generic[A, P, B, F]):  # noqa: N801 - used as a decorator
    """Method whose coroutine returns an asynchronous object; this method returns the object's face."""

    def __init__(
        self, method: Callable[Concatenate[A, P], Coroutine[Any, Any, B]], face: Callable[[B, LoopThread], F]
    ) -> None:
        self._method = method
        self._face = face
        self.__doc__ = method.__doc__

    def __get__(self, face: Face[A], owner: type[Face[A]]) -> Callable[P, F]:
        @functools.wraps(self._method)
        def make(*arguments: P.args, **named: P.kwargs) -> F:
            return self._face(face.loop.run(self._method(face.asynchronous, *arguments, **named)), face.loop)

        return make


class iterating(Generic[A, P, T]):  # noqa: N801 - used as a decorator
    """Method that returns an iterator over an asynchronous iterator of the asynchronous object."""

    def __init__(self, method: Callable[Concatenate[A, P], AsyncIterator[T]]) -> None:
        self._method = method
        self.__doc__ = method.__doc__

    def __get__(self, face: Face[A], owner: type[Face[A]]) -> Callable[P, Iterator[T]]:
        @functools.wraps(self._method)
        def begin(*arguments: P.args, **named: P.kwargs) -> Iterator[T]:
            return iterate(face.loop, self._method(face.asynchronous, *arguments, **named))

        return begin


def iterate(loop: LoopThread, values: AsyncIterator[T]) -> Iterator[T]:
    """Go over an asynchronous generator, and close it at the end."""
    try:
        while (value := loop.run(_next(values))) is not _End.END:
            yield value
    finally:
        loop.run(values.aclose())  # type: ignore[attr-defined]


async def _next(values: AsyncIterator[T]) -> T | Literal[_End.END]:
    async for value in values:
        return value
    return _End.END
