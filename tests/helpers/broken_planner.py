"""A planner process like the real one, but for requests whose group names a fault, or what racers do."""

import ctypes
import dataclasses
import itertools
import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from planners import worker
from planners.budget import never
from planners.pipeline import Planner
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, PlanningProblem, Request, StateAnswer

# Stands for a native library that holds the interpreter and never looks at signals.
NATIVE_LOOP = "native loop"
SEGFAULT = "segfault"
ABORT = "abort"
EXIT = "exit"
MEMORY = "memory"
EXCEPTION = "exception"
WRONG_ANSWER = "wrong answer"
NO_ANSWER = "no answer"
NOT_TO_BE_PACKED = "not to be packed"
NO_MESSAGE = "no message"
HUGE_MESSAGE = "huge message"
DEAF = "deaf"

# Ends of a racer's search, beside the faults: with a plan, or never before the allowed time.
PLAN = "plan"
NONE = "none"

# CPU time of a first racer's search that ends; that of the others takes twice as long, and all prove hard [s].
SEARCH_S = 3 * worker.HARD_AFTER_S


def _write_to_server(data: bytes) -> Any:
    """Write past the channel; a worker has no other socket."""
    (descriptor,) = (int(fd.name) for fd in Path("/proc/self/fd").iterdir() if fd.is_socket())
    os.write(descriptor, data)
    time.sleep(60.0)


def _eat_memory() -> Any:
    eaten = []
    while True:
        eaten.append(bytearray(16 << 20))


def _raise() -> Any:
    raise ValueError("a bug")


def _be_deaf() -> Any:
    while True:
        time.sleep(1.0)


FAULTS: dict[str, Callable[[], Any]] = {
    NATIVE_LOOP: lambda: max(itertools.repeat(0)),
    SEGFAULT: lambda: ctypes.string_at(0),
    ABORT: lambda: os.kill(os.getpid(), signal.SIGABRT),
    EXIT: lambda: os._exit(3),
    MEMORY: _eat_memory,
    EXCEPTION: _raise,
    WRONG_ANSWER: lambda: StateAnswer(valid=True, problems=()),
    NO_ANSWER: lambda: "yes",
    NOT_TO_BE_PACKED: lambda: lambda: None,
    NO_MESSAGE: lambda: _write_to_server(b"\x04\x00\x00\x00what"),
    HUGE_MESSAGE: lambda: _write_to_server(b"\xff\xff\xff\xff"),
    DEAF: _be_deaf,
}


def _search(problem: PlanningProblem, should_stop: Callable[[], bool], lasting_s: float) -> PlanningFailure | None:
    """Find nothing for so much CPU time; the failure of a search that is stopped, or lasts too long."""
    began_s = time.process_time()
    while (spent_s := time.process_time() - began_s) < lasting_s:
        if should_stop():
            return PlanningFailure(MoveItErrorCode.PREEMPTED, "stopped")
        if spent_s > problem.allowed_time_s:
            return PlanningFailure(MoveItErrorCode.TIMED_OUT, "no motion was found")
    return None


def racers(first: str, others: str) -> str:
    """Group of a problem: how the search ends for the first racer, who has seed 0, and how for the others."""
    return f"{first}|{others}"


class BrokenPlanner(Planner):
    """Plans, unless the group is a fault's name, or says what racers do."""

    def answer(self, request: Request, should_stop: Callable[[], bool] = never) -> Answer:
        if isinstance(request, PlanningProblem) and "|" in request.group:
            other = request.seed > 0
            end = request.group.split("|")[other]
            stopped = _search(request, should_stop, math.inf if end == NONE else SEARCH_S * (1 + other))
            if stopped is not None:
                return stopped
            request = dataclasses.replace(request, group="arm" if end == PLAN else end)
        fault = FAULTS.get(getattr(request, "group", ""))
        if fault is not None:
            answer: Answer = fault()
            return answer
        return super().answer(request, should_stop)


if __name__ == "__main__":
    worker.main(BrokenPlanner)
