"""The planner process: takes problems, gives plans, one at a time.

Started by :mod:`planners.pool`; the signal of :mod:`planners.messages` makes it give up the problem in hand.
"""

from __future__ import annotations

import logging
import os
import signal
import time

from planners.messages import CANCEL_SIGNAL, Loaded, LoadFailed, LoadRobot, Solve, Solved
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from robot.model import RobotModel
from robot.processes import Channel, channel_of_child

log = logging.getLogger("armbridge.planner")


class StopFlag:
    """Raised by the cancel signal, lowered before each problem."""

    def __init__(self) -> None:
        self.raised = False
        signal.signal(CANCEL_SIGNAL, lambda _number, _frame: self._raise())

    def _raise(self) -> None:
        self.raised = True


def run(channel: Channel) -> None:
    """Serve the server's problems until it closes the channel."""
    stop = StopFlag()
    planner: Planner | None = None
    while not channel.closed:
        for message in channel.receive(timeout_s=None):
            if isinstance(message, LoadRobot):
                planner = _load(message.robot, channel)
            elif isinstance(message, Solve) and planner is not None:
                stop.raised = False
                channel.send(Solved(message.number, _solve(planner, message.problem, stop)))


def _load(robot: RobotModel, channel: Channel) -> Planner | None:
    started_s = time.monotonic()
    try:
        planner = Planner(robot)
    except Exception as error:
        log.exception("cannot load the robot %r", robot.name)
        channel.send(LoadFailed(f"{type(error).__name__}: {error}"))
        return None
    channel.send(Loaded(time.monotonic() - started_s))
    return planner


def _solve(planner: Planner, problem: PlanningProblem, stop: StopFlag) -> Plan | PlanningFailure:
    try:
        return planner.plan(problem, lambda: stop.raised)
    except Exception as error:  # a bug in one plan must not take the worker and its warm libraries with it
        log.exception("planning failed on %r", problem)
        return PlanningFailure(MoveItErrorCode.CRASH, f"the planner failed: {type(error).__name__}: {error}")


if __name__ == "__main__":
    run(channel_of_child())
    # Not through the interpreter's end, where the native libraries print what they think they leaked.
    os._exit(0)
