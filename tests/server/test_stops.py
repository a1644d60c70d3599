"""A stop at every moment: each kind of request that may move the arm is held up at each of its steps, and a stop comes.

The parts of the server are the real ones, in stepped time; the arm takes what the real one takes.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from contextlib import asynccontextmanager, suppress
from contextvars import Context
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from robot.messages import CommandDone, Mode, MotionEnded, Order, Setpoint
from robot.stop_epochs import STOP_EPOCHS
from robot.trajectory import Trajectory
from server import arrival
from server.arrival import arrived_in
from server.errors import GraphError
from server.graph.permissions import Node
from tests.helpers.fake_arm import FakeArm
from tests.helpers.stage import CHUNK, REQUESTS, ServerStage, follow, inline_threads

pytestmark = pytest.mark.stepped_time

# Each motion of the arm [s].
MOTION_S = 0.4

# Everything that a request begins is over by then, or goes on until it is stopped [s].
TRIAL_S = 4.0

# What a stop fails to end begins to move within that time: planning and the motion before take less [s].
AFTER_STOP_S = 1.0

# A following and a chunk begin to move by step 16 and then make the same steps every 10 ms.
MOST_STEPS = 40

# To listen, to plan and make the way to the leader, and to begin to follow.
LEAST_STEPS_OF_FOLLOWING = 12


class TimedArm(FakeArm):
    """Arm whose motions end by themselves, and which notes every motion that it begins.

    Attributes:
        begun: motions, streams that moved and switches of torque since the last stop.
    """

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[str] = []
        self.pid = 7

    def execute(self, trajectory: Trajectory, **options: Any) -> asyncio.Future[MotionEnded]:
        ended = super().execute(trajectory, **options)
        if not ended.done():
            self.begun.append(f"a motion of {', '.join(trajectory.joint_names)}")
            asyncio.get_running_loop().call_later(MOTION_S, self.end)
        return ended

    def order(self, order: Order, _calibration: object = None, epoch: int | None = None) -> asyncio.Future[CommandDone]:
        answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()
        stopped = epoch is not None and epoch < self.last_stop
        if order is Order.ENABLE and not stopped:
            self.begun.append("torque on")
            self.state = replace(self.state, torque_enabled=True)
        done = CommandDone(0, done=not stopped, message="a stop came" if stopped else "done")
        asyncio.get_running_loop().call_later(0.01, answered.set_result, done)
        return answered

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        super().stop(motion)
        if motion is None:
            self.begun.clear()

    def take_setpoints(self) -> None:
        """Note the setpoints of streams that are not at rest."""
        moving, self.setpoints[:] = [each for each in self.setpoints if np.any(each.velocity_rad_s)], []
        self.begun += [f"a stream at {each.velocity_rad_s}" for each in cast("list[Setpoint]", moving)]

    async def rest(self, _timeout_s: float) -> bool:
        await asyncio.sleep(0.05)
        return True

    def keep_parking(self, plan: object) -> None:
        pass

    async def end_streams(self, _timeout_s: float) -> bool:
        await asyncio.sleep(0.01)
        return True


class SteppedCoroutine(Coroutine[Any, Any, Any]):
    """Coroutine that calls a function before each of its steps."""

    def __init__(self, coroutine: Generator[Any, Any, Any] | Coroutine[Any, Any, Any], before: Callable[[], None]):
        self._coroutine, self._before = coroutine, before

    def send(self, value: Any) -> Any:
        self._before()
        return self._coroutine.send(value)

    def throw(self, *error: Any) -> Any:
        return self._coroutine.throw(*error)

    def close(self) -> None:
        self._coroutine.close()

    def __await__(self) -> Generator[Any, Any, Any]:
        yield from ()


class Stage(ServerStage):
    """Server without sockets, a client that asks for one motion, and another client that stops the arm.

    Attributes:
        steps: steps of all tasks that the request has started.
    """

    def __init__(self) -> None:
        self.arm = TimedArm()
        super().__init__(self.arm.as_arm)
        self.other = Node("other", remote=True)
        self.steps = 0
        self._stop_at = 0
        self._stopped = asyncio.Event()
        self._stop: Callable[[], None] = lambda: None

    def stop_by_topic(self) -> None:
        self.graph.publish(self.other, "/stop", {})

    def stop_by_service(self) -> None:
        self.graph.services.call(self.other, "/arm/stop", {}, lambda _response: None)

    def stop_some(self, service: str) -> None:
        self.graph.services.call(self.other, service, {}, lambda _response: None)
        self.arm.begun.clear()

    def task(self, loop: asyncio.AbstractEventLoop, coroutine: Any, **options: Any) -> asyncio.Task[Any]:
        """Make the tasks of the event loop; those of the request count their steps."""
        if arrival._EPOCH.get() is not None:
            coroutine = SteppedCoroutine(coroutine, self._before_step)
        return asyncio.Task(coroutine, loop=loop, **options)

    def _before_step(self) -> None:
        self.steps += 1
        self.arm.take_setpoints()
        if self.steps == self._stop_at:
            self._stop_now()

    def _stop_now(self) -> None:
        # As by the frame of another client, in a context of its own.
        Context().run(self._stop)
        self._stopped.set()

    async def trial(self, request: Callable[[Stage], None], stop: Callable[[], None], stop_at: int) -> bool:
        """Make a request, and stop before one of its steps, 0 being before its handler runs.

        Returns:
            False when the request had fewer steps.
        """
        self._stop, self._stop_at, self.steps = stop, stop_at, 0
        self._stopped.clear()
        epoch = STOP_EPOCHS.present
        if stop_at == 0:
            self._stop_now()
        with arrived_in(epoch), suppress(GraphError):
            request(self)
        # In the context of nothing: what goes on by itself is no part of the request.
        with suppress(TimeoutError):
            await asyncio.wait_for(self._stopped.wait(), TRIAL_S)
            await asyncio.sleep(AFTER_STOP_S)
        self.arm.take_setpoints()
        return self.steps >= stop_at

    def prepare(self) -> None:
        """Be at rest at home, relaxed, with nothing to do and no leader."""
        for each in self.answers:
            if isinstance(each, asyncio.Future):
                each.cancel()
        self.answers.clear()
        self.stop_by_topic()
        self.call("/servo_node/reset_servo_status")
        self.arm.put()
        self.arm.state = replace(self.arm.state, mode=Mode.HOLDING, torque_enabled=False)
        self.arm.begun.clear()
        self.arm.played.clear()


@asynccontextmanager
async def staged() -> AsyncIterator[Stage]:
    stage = Stage()
    await stage.save_wave()
    loop = asyncio.get_running_loop()
    loop.set_task_factory(stage.task)
    try:
        yield stage
    finally:
        loop.set_task_factory(None)
        await stage.close()


@pytest.mark.parametrize("request_", REQUESTS.values(), ids=REQUESTS.keys())
async def test_nothing_moves_after_a_stop_whichever_step_of_a_request_it_comes_before(
    request_: Callable[[Stage], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    inline_threads(monkeypatch)
    async with staged() as stage:
        await stage.trial(request_, stage.stop_by_topic, -1)
        assert stage.arm.begun, "without a stop"
        for stop_at in range(MOST_STEPS):
            stage.prepare()
            # In turn, by the ways of a stop.
            stop = stage.stop_by_service if stop_at % 2 else stage.stop_by_topic
            if not await stage.trial(request_, stop, stop_at):
                assert stop_at > 0
                return
            assert stage.arm.begun == [], f"after a stop before step {stop_at}"
            assert not stage.teleoperation.observes_states, f"after a stop before step {stop_at}"


def chunk_on_topic(stage: Stage) -> None:
    stage.publish("/arm/chunks", "armbridge_msgs/ActionChunk", {"trajectory": CHUNK})


def unpaused_stick(stage: Stage) -> None:
    stage.call("/servo_node/unpause_servo")
    REQUESTS["a jog"](stage)


@pytest.mark.parametrize(
    ("request_", "service"),
    [
        (REQUESTS["a chunk"], "/arm/chunks/stop"),
        (chunk_on_topic, "/arm/chunks/stop"),
        (unpaused_stick, "/servo_node/stop_servo"),
    ],
)
async def test_a_request_that_a_stop_of_its_own_kind_has_overtaken_moves_nothing(
    request_: Callable[[Stage], None], service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    inline_threads(monkeypatch)
    async with staged() as stage:
        await stage.trial(request_, lambda: stage.stop_some(service), 0)
        assert stage.arm.begun == []


async def test_nothing_follows_after_a_stop_before_whichever_step_of_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    inline_threads(monkeypatch)
    async with staged() as stage:
        for stop_at in range(MOST_STEPS):
            stage.prepare()
            if not await stage.trial(follow, lambda: stage.stop_some("/teleop/stop"), stop_at):
                # The leader has left, to which the arm had gone before.
                assert stop_at > LEAST_STEPS_OF_FOLLOWING
                return
            assert not stage.teleoperation.observes_states, f"after a stop before step {stop_at}"
