"""Planning problems mapped over the workers of a Dask cluster, by Dask's own ``Client.map`` and ``as_completed``.

Dask's messages are pickled objects, so workers must run the same armbridge; that is checked first. Dask gives the
problems of a worker that dies to another one. The package distributed is the extra ``armbridge[dask]``: it is imported
where it is used.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import pickle
import re
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import metadata, resources
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from planners.errors import BatchError
from planners.files.problem_file import ProblemFile
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.description.model import RobotModel

if TYPE_CHECKING:
    from distributed import Client, Future

# A scheduler answers within milliseconds, and its workers need seconds to join when they are just starting.
CONNECT_TIMEOUT_S = 5.0

# Planners of a few MB each that a worker keeps: one for each of its threads and each of the last files.
MAX_PLANNERS = 8

# All that is pickled, and all that makes the answers, is defined there.
_SOURCES = (("planners", "**/*.py"), ("robot", "description/*.py"), ("robot", "trajectory.py"))


@dataclass(frozen=True)
class Setup:
    """All that the problems of a file share."""

    digest: str  # of robot and scene, by which setups are distinguished
    robot: RobotModel = field(compare=False)  # the arm to plan for
    scene: Scene = field(compare=False)


def plan_on(
    address: str, problems: Sequence[tuple[ProblemFile, PlanningProblem]]
) -> Iterator[tuple[int, Plan | PlanningFailure, float]]:
    """Plan problems on the Dask cluster of a scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``.

    Yields number, answer and CPU time [s] of each problem, in the order in which they are answered. BatchError: there
    is no cluster that can plan them.
    """
    with _connected(address) as client:
        from distributed import CancelledError, as_completed

        _check_workers(client, address)
        # As tasks, and not scattered: a setup that is lost with a worker is made again on another one.
        setups = {id(file): client.submit(pickle.loads, _packed_setup(file), pure=False) for file, _ in problems}
        futures = client.map(
            answer,
            [setups[id(file)] for file, _ in problems],
            # Packed: Dask would search for its own objects inside.
            [pickle.dumps(problem) for _, problem in problems],
            asked_by=version(),
            pure=False,
        )
        numbers = {future.key: number for number, future in enumerate(futures)}
        try:
            for future in as_completed(futures):
                yield numbers[future.key], *_result(future)
        except (CancelledError, OSError) as error:
            raise BatchError(f"the Dask scheduler {address} was lost") from error


def answer(setup: Setup, problem: bytes, asked_by: str) -> tuple[Plan | PlanningFailure, float]:
    """Plan a pickled :class:`PlanningProblem` in a Dask worker; return the answer and the CPU time spent on it [s].

    BatchError: this worker, which joined after the others had been checked, runs another armbridge.
    """
    if asked_by != version():
        raise BatchError("the worker runs another armbridge")
    planner, refusal = _planner(setup, threading.get_ident())
    started_s = time.thread_time()
    planned = refusal or planner.plan(pickle.loads(problem))  # noqa: S301 - of the one whose tasks this worker runs
    return planned, time.thread_time() - started_s


@functools.cache
def version() -> str:
    """Return armbridge's version and a digest of the code of its planners, as in ``0.1.0 (planners 3fa2b1c4)``."""
    digest = hashlib.sha256()
    for package, pattern in _SOURCES:
        with resources.as_file(resources.files(package)) as folder:
            for path in sorted(folder.glob(pattern)):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{metadata.version('armbridge')} (planners {digest.hexdigest()[:8]})"


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """Connect to a scheduler; leaving the context cancels open problems."""
    if find_spec("distributed") is None:
        raise BatchError("--scheduler needs the package distributed: pip install 'armbridge[dask]'")
    if not re.fullmatch(r"(tcp|tls)://[^/@\s]+:\d+", address):
        raise BatchError(f"--scheduler {address}: must be tcp://HOST:PORT or tls://HOST:PORT")
    from distributed import Client

    # It logs pages of tracebacks for each failure; BatchError has what matters. Tornado's logger has the one of an
    # interrupt that meets distributed.utils.sync before its coroutine begins: its cancel() then knows no future.
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        # Dask's own configuration names the certificates of tls://.
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, TypeError, ValueError) as error:
        raise BatchError(f"the Dask scheduler {address} cannot be reached: {error}") from error
    with client:
        yield client


def _check_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
    except TimeoutError as error:
        raise BatchError(f"the Dask scheduler {address} has no workers") from error
    for worker, theirs in client.run(version, on_error="return").items():
        if isinstance(theirs, Exception):
            reason = f"cannot run armbridge: {theirs}"
        elif theirs != version():
            reason = f"runs armbridge {theirs}"
        else:
            continue
        raise BatchError(f"the Dask worker {worker} {reason}; install armbridge {version()} there, as here")


def _packed_setup(file: ProblemFile) -> bytes:
    digest = hashlib.sha256(pickle.dumps((file.robot, file.scene))).hexdigest()
    return pickle.dumps(Setup(digest, file.robot, file.scene))


@functools.lru_cache(maxsize=MAX_PLANNERS)
def _planner(setup: Setup, _thread: int) -> tuple[Planner, PlanningFailure | None]:
    """Make the planner of one thread, and return the flaw of the scene; planners work on one problem at a time.

    Allowed times are the thread's CPU time: what other threads of the worker do, and Dask itself, does not count.
    """
    planner = Planner(setup.robot, time.thread_time)
    return planner, planner.set_scene(setup.scene)


def _result(future: Future[Any]) -> tuple[Plan | PlanningFailure, float]:
    from distributed import KilledWorker

    error = future.exception()
    if error is None:
        planned: tuple[Plan | PlanningFailure, float] = future.result()
        return planned
    if isinstance(error, KilledWorker):
        message = f"{error.allowed_failures + 1} workers ended while they worked on this"
    else:
        message = f"the worker failed: {type(error).__name__}: {error}"
    return PlanningFailure(MoveItErrorCode.CRASH, message), 0.0
