"""Fork server: a child that loads once what several processes need, and is copied; its server's end is in processes.

A copy shares the loaded memory and is ready at once; a process of its own would load for a second. Copies end with
their template, and it ends with the server.
"""

from __future__ import annotations

import ctypes
import gc
import os
import select
import signal
from dataclasses import dataclass

from robot.channel import Channel

PR_SET_PDEATHSIG = 1  # of linux/prctl.h


@dataclass(frozen=True)
class Ready:
    """The template has loaded."""


@dataclass(frozen=True)
class Copy:
    """Request for a copy; the socket of the copy's channel comes with it."""


@dataclass(frozen=True)
class Copied:
    """The copy runs."""

    pid: int


@dataclass(frozen=True)
class CopyEnded:
    """A copy has ended, with an exit code or the negative number of a signal."""

    pid: int
    code: int


def serve_copies(channel: Channel) -> None:
    """Be a template that has loaded, in a process without threads, until the server ends; return in each copy.

    In a copy the channel is the copy's.
    """
    # The garbage collector would write to the loaded memory, and so end its sharing.
    gc.collect()
    gc.freeze()
    channel.send(Ready())
    readable = select.poll()
    readable.register(channel, select.POLLIN)
    # The process id of each copy, by the end of a pipe that it holds open as long as it runs.
    copies: dict[int, int] = {}
    template = os.getpid()
    while not channel.closed:
        for descriptor, _ in readable.poll():
            if descriptor in copies:
                readable.unregister(descriptor)
                os.close(descriptor)
                pid = copies.pop(descriptor)
                channel.send(CopyEnded(pid, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])))
                continue
            for _ in channel.receive(timeout_s=0.0):
                end, held = os.pipe()
                if (pid := os.fork()) == 0:
                    _be_copy(channel, template, (end, *copies))
                    return
                os.close(held)
                os.close(channel.passed.popleft())
                copies[end] = pid
                readable.register(end, select.POLLIN)
                channel.send(Copied(pid))
    os._exit(0)


def _be_copy(channel: Channel, template: int, of_template: tuple[int, ...]) -> None:
    for each in of_template:
        os.close(each)
    channel.move_to(channel.passed.popleft())
    os.setsid()
    end_with_parent(template)


def end_with_parent(parent: int, number: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel end this process with its parent: a process that hangs never sees its socket close."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:
        os._exit(1)
