"""A planner process like the real one, but for requests whose group names a fault."""

import ctypes
import itertools
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from planners import worker
from planners.budget import never
from planners.pipeline import Planner
from planners.problem import Answer, Request, StateAnswer

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


class BrokenPlanner(Planner):
    """Plans, unless the group is a fault's name."""

    def answer(self, request: Request, should_stop: Callable[[], bool] = never) -> Answer:
        fault = FAULTS.get(getattr(request, "group", ""))
        if fault is not None:
            answer: Answer = fault()
            return answer
        return super().answer(request, should_stop)


if __name__ == "__main__":
    worker.main(BrokenPlanner)
