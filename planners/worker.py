"""The planner process: exchanges the messages of :mod:`planners.messages` with a pool, one request at a time."""

from __future__ import annotations

import contextlib
import faulthandler
import logging
import os
import resource
import select
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

from planners.errors import PlannerError
from planners.messages import (
    Answered,
    Ask,
    Cancel,
    Loaded,
    LoadFailed,
    LoadRobot,
    MoreObjects,
    NewScene,
    SceneReceiver,
    StillSearching,
)
from planners.pipeline import Planner
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, PlanningProblem, Request
from robot.channel import Channel, channel_of_child
from robot.description.model import RobotModel
from robot.template import end_with_parent, serve_copies

log = logging.getLogger("armbridge.planner")

# When the machine runs out of memory a planner is to go first: it costs one goal, the arm process costs the arm.
OOM_SCORE = "600"

# Of 375 motions between poses of the benchmark's scenes, 91 % were planned sooner. Between 0.04 and 0.08 s it matters
# little: races take 0.68 to 0.70 times as long as one search, and 1.2 times the CPU time.
HARD_AFTER_S = 0.06

MakePlanner: TypeAlias = Callable[[RobotModel], Planner]


class Mailbox:
    """Messages from the server, received also while a request is worked on."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._messages: deque[Any] = deque()
        self._readable = select.poll()
        self._readable.register(channel, select.POLLIN)

    def next(self) -> Any:
        """Wait for the next message; None once the server is gone."""
        while not self._messages and not self._channel.closed:
            self._messages += self._channel.receive(timeout_s=None)
        return self._messages.popleft() if self._messages else None

    def withdrawn(self, number: int) -> bool:
        """Return true if a request is cancelled, or the server gone; called thousands of times a second."""
        if self._readable.poll(0):
            self._messages += self._channel.receive(timeout_s=0.0)
        return self._channel.closed or Cancel(number) in self._messages


class Worker:
    """Serves one server; ``make_planner`` loads a robot."""

    def __init__(self, channel: Channel, make_planner: MakePlanner) -> None:
        self._channel = channel
        self._mailbox = Mailbox(channel)
        self._make_planner = make_planner
        self._scene = SceneReceiver()
        self._planner: Planner | None = None
        self._memory_limit_bytes = 0
        self._ending = False

    def run(self) -> None:
        """Serve until the server closes the channel, or memory has run out."""
        while not self._ending and (message := self._mailbox.next()) is not None:
            self._take(message)

    def _take(self, message: Any) -> None:
        match message:
            case LoadRobot():
                self._load(message)
            case NewScene() | MoreObjects():
                self._scene.take(message)
            case Ask(number, request) if self._planner is not None:
                answer = self._answer(self._planner, number, request)
                self._channel.send(Answered(number, answer, self._ending))

    def _load(self, message: LoadRobot) -> None:
        self._memory_limit_bytes = message.memory_limit_bytes
        limit_memory(message.memory_limit_bytes)
        try:
            self._planner = self._make_planner(message.robot)
        except PlannerError as error:
            self._channel.send(LoadFailed(str(error)))
        except Exception as error:
            log.exception("cannot load the robot %r", message.robot.name)
            self._channel.send(LoadFailed(f"{type(error).__name__}: {error}"))
        else:
            self._channel.send(Loaded())

    def _answer(self, planner: Planner, number: int, request: Request) -> Answer:
        try:
            return planner.set_scene(self._scene.scene()) or planner.answer(request, self._poll(number, request))
        except MemoryError:
            # The state of the native libraries is not known after that.
            self._ending = True
            limit_mb = self._memory_limit_bytes / 1e6
            log.error("a planner ran out of its %.0f MB on a %s", limit_mb, type(request).__name__)  # noqa: TRY400
            text = f"the planner needed more than the {limit_mb:.0f} MB of memory that it may use, and was restarted"
            return PlanningFailure(MoveItErrorCode.CRASH, text, {"memory_limit_mb": limit_mb})
        except Exception as error:  # a bug in one request must not take the worker and its warm libraries with it
            log.exception("planning failed on %r", request)
            return PlanningFailure(MoveItErrorCode.CRASH, f"the planner failed: {type(error).__name__}: {error}")

    def _poll(self, number: int, request: Request) -> Callable[[], bool]:
        """Return the function by which a planner checks all the time if its request is cancelled.

        For a problem that takes longer than most it also reports that, again each time that its time has doubled. Only
        processor time counts, as other processes make no problem hard, and no time that the problem asks to be
        shortened for.
        """
        if not isinstance(request, PlanningProblem):
            return lambda: self._mailbox.withdrawn(number)
        began_s, began_cpu_s = time.monotonic(), time.process_time()
        next_s = request.optimization_time_s + HARD_AFTER_S

        def poll() -> bool:
            nonlocal next_s
            spent_cpu_s = time.process_time() - began_cpu_s
            if spent_cpu_s >= next_s:
                next_s = 2.0 * spent_cpu_s
                self._channel.send(StillSearching(number, time.monotonic() - began_s))
            return self._mailbox.withdrawn(number)

        return poll


def limit_memory(limit_bytes: int) -> None:
    """Bound this process's data, not its address space: libraries map several times the memory they use."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        limit_bytes = min(limit_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, hard))


def main(make_planner: MakePlanner) -> None:
    """Load a robot and be the template of planner processes, and each of them, until the server ends it."""
    # The server logs which signal ended a worker; the place in the code is known only here.
    faulthandler.enable()
    end_with_parent(os.getppid())
    try:
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    except OSError as error:
        log.debug("oom_score_adj cannot be set: %s", error)
    channel = channel_of_child()
    planner: Planner | None = None
    if isinstance(load := channel.receive_first(), LoadRobot):
        limit_memory(load.memory_limit_bytes)
        # A worker tries again what fails here, and says why.
        with contextlib.suppress(Exception):
            planner = make_planner(load.robot)
    serve_copies(channel)
    worker = Worker(channel, lambda robot: planner or make_planner(robot))
    try:
        worker.run()
    except Exception:
        log.exception("the planner process ends")
        os._exit(1)
    # Not through the interpreter's end, where the native libraries print what they think they leaked.
    os._exit(0)


def warm_planner(robot: RobotModel) -> Planner:
    """Load a robot as :class:`planners.pipeline.Planner` does, and make its first plans."""
    planner = Planner(robot)
    planner.warm_up()
    return planner


if __name__ == "__main__":
    main(warm_planner)
