"""Interruptions of calls and motions, by threads, signals, deadlines and a lost server."""

import asyncio
import contextlib
import itertools
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import FrameType
from typing import Any

import pytest

from armbridge_client import Arm, ConnectionLost, DeadlineExceeded, GoalRefused, connect, connect_async
from armbridge_client.blocking import LoopThread
from armbridge_client.messages import MoveitGoalFeedback
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S, join, wait_until

PREEMPTED = -7


def once_moving(arm: Arm, then: threading.Thread) -> None:
    """Move slowly, and begin a thread once the arm moves."""

    def on_progress(progress: MoveitGoalFeedback) -> None:
        if progress.state == "executing" and then.ident is None:
            then.start()

    arm.move_named("home")
    arm.move("rest", speed=0.05, on_progress=on_progress)


def signalling(number: signal.Signals) -> threading.Thread:
    return threading.Thread(target=os.kill, args=(os.getpid(), number))


@pytest.mark.parametrize("by", ["thread", "signal"])
def test_another_thread_or_a_signal_handler_stops_the_arm_while_the_program_waits(arm: Arm, by: str) -> None:
    sentences: list[str] = []

    def stop(*_: object) -> None:
        sentences.append(arm.stop())

    before = signal.signal(signal.SIGUSR1, stop)
    stopper = threading.Thread(target=stop) if by == "thread" else signalling(signal.SIGUSR1)
    try:
        with pytest.raises(GoalRefused) as caught:
            once_moving(arm, stopper)
        join(stopper)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert caught.value.code == PREEMPTED
    assert sentences


def test_an_error_of_the_function_that_takes_the_progress_costs_neither_motion_nor_connection(arm: Arm) -> None:
    def fail(_progress: object) -> None:
        raise RuntimeError("a bug of the program")

    arm.move_named("home")
    assert arm.move("ready", on_progress=fail).message
    assert arm.state().mode == "holding"


def test_ctrl_c_cancels_the_motion(arm: Arm) -> None:
    with pytest.raises(KeyboardInterrupt):
        once_moving(arm, signalling(signal.SIGINT))
    # Answered when the arm stands; nothing of the motion is left.
    arm.stop()
    wait_until(lambda: arm.state().mode == "holding")


def test_a_deadline_cancels_the_motion(arm: Arm) -> None:
    arm.move_named("home")
    with pytest.raises(DeadlineExceeded, match=r"not done within 0\.2 s"):
        arm.move_named("rest", speed=0.05, timeout_s=0.2)
    arm.stop()
    wait_until(lambda: arm.state().mode == "holding")


def test_a_motion_stops_when_its_program_leaves(server: RunningServer, arm: Arm) -> None:
    left = connect(server.url)
    leaver = threading.Thread(target=left.close)
    with pytest.raises((ConnectionLost, GoalRefused)):
        once_moving(left, leaver)
    join(leaver)
    next(state for state in arm.states() if state.mode == "holding")
    assert arm.state().position_rad["shoulder_lift"] > -1.4


def test_a_closed_arm_refuses_everything(server: RunningServer) -> None:
    arm = connect(server.url)
    arm.close()
    arm.close()
    for request in (arm.stop, arm.state):
        with pytest.raises(ConnectionLost, match="has closed the connection"):
            request()


async def test_a_signal_handler_of_the_event_loop_stops_the_arm(server: RunningServer) -> None:
    loop = asyncio.get_running_loop()
    async with await connect_async(server.url) as arm:
        await arm.move_named("home")
        loop.add_signal_handler(signal.SIGUSR1, arm.stop_soon)
        try:
            with pytest.raises(GoalRefused) as caught:
                await arm.move("rest", speed=0.05, on_progress=signal_while_moving)
        finally:
            loop.remove_signal_handler(signal.SIGUSR1)
        assert caught.value.code == PREEMPTED


def signal_while_moving(progress: MoveitGoalFeedback) -> None:
    if progress.state == "executing":
        os.kill(os.getpid(), signal.SIGUSR1)


def test_a_stop_ends_the_gripper_and_the_program_knows(arm: Arm) -> None:
    arm.gripper.close()
    with ThreadPoolExecutor() as threads:
        opening = threads.submit(arm.gripper.open)
        next(state for state in arm.states(rate_hz=50) if state.position_rad["gripper"] > 0.1)
        arm.stop()
        with pytest.raises(GoalRefused, match=r"PREEMPTED \(-7\): the gripper was stopped"):
            opening.result(TIMEOUT_S)


def test_a_motion_goes_on_without_its_client_where_the_client_chose_so() -> None:
    """Also where the server's own setting is that goals end with their client."""
    with RunningServer(settings={"ARMBRIDGE_GOALS__ON_DISCONNECT": "stop"}) as server, connect(server.url) as watcher:
        begun = threading.Event()
        leaving = connect(server.url, on_disconnect="finish")

        def move() -> None:
            with contextlib.suppress(ConnectionLost):
                leaving.move({"shoulder_pan": 0.8}, speed=0.2, on_progress=on_progress)

        def on_progress(progress: MoveitGoalFeedback) -> None:
            if progress.state == "executing":
                begun.set()

        thread = threading.Thread(target=move)
        thread.start()
        assert begun.wait(TIMEOUT_S)
        leaving.close()
        join(thread)
        wait_until(lambda: watcher.state().position_rad["shoulder_pan"] == pytest.approx(0.8, abs=0.02))


def test_an_interrupt_while_the_loop_is_woken_cancels_what_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    async def lasting() -> None:
        begun.set()
        try:
            await asyncio.sleep(TIMEOUT_S)
        finally:
            ended.set()

    loop = LoopThread()
    wake = loop._loop._write_to_self  # type: ignore[attr-defined]

    def interrupted() -> None:
        monkeypatch.undo()
        wake()
        assert begun.wait(TIMEOUT_S)
        raise KeyboardInterrupt

    monkeypatch.setattr(loop._loop, "_write_to_self", interrupted)
    with pytest.raises(KeyboardInterrupt):
        loop.run(lasting())
    assert ended.is_set()
    loop.end()


MOTION_S = 0.02


@pytest.fixture
def loop() -> Iterator[LoopThread]:
    made = LoopThread()
    yield made
    made.end()


class Motion:
    """A call that waits for the end of a motion, and a signal handler that stops the motion in one line of the call."""

    def __init__(self, loop: LoopThread, line: int) -> None:
        self.interrupted = False
        self._loop = loop
        self._lines_until = line
        self._ending = asyncio.Event()

    async def move(self) -> str:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._ending.wait(), MOTION_S)
        return "ended"

    async def stop(self) -> None:
        self._ending.set()
        for _ in range(5):  # the motion ends before the answer, as on a server
            await asyncio.sleep(0)

    def trace(self, _frame: FrameType, event: str, _argument: object) -> Any:
        """Stand for the signal: Python runs a handler between two steps of what it interrupts."""
        if event == "line" and not self.interrupted:
            self.interrupted = self._lines_until == 0
            self._lines_until -= 1
            if self.interrupted:
                self._loop.run(self.stop())
        return self.trace

    def run(self) -> str:
        moving = self.move()
        sys.settrace(self.trace)
        try:
            return self._loop.run(moving)
        finally:
            sys.settrace(None)


def test_a_signal_handler_in_any_line_of_a_call_may_end_what_the_call_waits_for(loop: LoopThread) -> None:
    lines: list[int] = []

    def interrupt_every_line() -> None:
        for line in itertools.count():
            motion = Motion(loop, line)
            assert motion.run() == "ended"
            if not motion.interrupted:
                break
            lines.append(line)

    thread = threading.Thread(target=interrupt_every_line, daemon=True)
    thread.start()
    join(thread)
    assert len(lines) > 10


def test_after_its_end_it_runs_nothing(loop: LoopThread) -> None:
    loop.end()

    async def nothing() -> None: ...

    with pytest.raises(ConnectionLost, match="has closed the connection"):
        loop.run(nothing())
