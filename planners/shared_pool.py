"""Planners that several servers share, as one of them sees them: a connection to :mod:`planners.pool_host`."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import time
from pathlib import Path

from planners.interface import LOAD_TIMEOUT_S, Planners
from planners.messages import Answered, Ask, Cancel, Loaded, LoadFailed
from planners.pool_host import LONGEST_PLANNING_S, READ_BYTES
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, Request
from planners.scene import Scene
from planners.scene_transfer import SceneSender
from robot.channel import Decoder, encode
from robot.processes import RestartDelay

log = logging.getLogger("armbridge.planners")

# Rounds that a request may wait for its turn, each of the longest planning: the host itself answers long before.
ROUNDS = 6
ANSWER_TIMEOUT_S = ROUNDS * LONGEST_PLANNING_S


class SharedPlanners(Planners):
    """Connection to a host of planners, at its socket: one motion and one question at a time go there.

    Nothing is planned in the background: requests of other servers would have to wait.
    """

    def __init__(self, address: Path) -> None:
        super().__init__(in_background=False)
        self._address = address
        self._numbers = itertools.count(1)
        self._answers: dict[int, asyncio.Future[Answer]] = {}
        self._pids: tuple[int, ...] = ()
        self._hosted = asyncio.Event()
        self._hosted_or_refused = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._sending = asyncio.Lock()
        self._scenes = SceneSender(self._write, self._drain)
        self._connecting: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to connect; requests sent meanwhile wait."""
        self._connecting = asyncio.create_task(self._stay_connected(), name="connection to the planners")

    async def close(self) -> None:
        """Close the connection."""
        if self._connecting is not None:
            self._connecting.cancel()
            await asyncio.wait([self._connecting])

    async def wait_until_loaded(self) -> str | None:
        """Wait until the host has planners; return the reason for which they cannot plan for the robot, else None."""
        await self._hosted_or_refused.wait()
        return self.load_failure

    @property
    def pids(self) -> tuple[int, ...]:
        """Ids of the shared processes; none while there is no connection."""
        return self._pids

    @property
    def loaded_count(self) -> int:
        """Number of shared processes that have loaded the robot."""
        return len(self._pids)

    @property
    def idle_count(self) -> int:
        """Number of shared processes while none works for this server."""
        return len(self._pids) if not self._answers else 0

    async def _answer(self, request: Request, scene: Scene) -> Answer:
        try:
            async with asyncio.timeout(LOAD_TIMEOUT_S):
                await self._hosted.wait()
        except TimeoutError:
            reason = self.load_failure or f"the shared planners were not ready within {LOAD_TIMEOUT_S:g} s"
            return PlanningFailure(MoveItErrorCode.FAILURE, f"planning is not available: {reason}")
        number = next(self._numbers)
        answer: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                async with self._sending:
                    await self._scenes.send(scene)
                    self._write(Ask(number, request))
                return await answer
        except TimeoutError:
            self._write(Cancel(number))
            message = f"the shared planners did not answer within {ANSWER_TIMEOUT_S:g} s"
            return PlanningFailure(MoveItErrorCode.TIMED_OUT, message)
        except ValueError as error:
            return PlanningFailure(MoveItErrorCode.FAILURE, f"the problem cannot be given to a planner: {error}")
        except asyncio.CancelledError:
            self._write(Cancel(number))
            raise
        finally:
            self._answers.pop(number, None)

    def _write(self, message: object) -> None:
        if self._writer is not None:
            self._writer.write(encode(message))

    async def _drain(self) -> None:
        if self._writer is not None:
            with contextlib.suppress(OSError):
                await self._writer.drain()

    async def _stay_connected(self) -> None:
        delay = RestartDelay()
        while True:
            began_s = time.monotonic()
            try:
                reader, self._writer = await asyncio.open_unix_connection(self._address)
                await self._receive(reader)
            except (OSError, ValueError) as error:
                log.debug("the shared planners cannot be reached: %s", error)
            finally:
                self._disconnect()
            await asyncio.sleep(delay.after(time.monotonic() - began_s))

    async def _receive(self, reader: asyncio.StreamReader) -> None:
        decoder = Decoder()
        while data := await reader.read(READ_BYTES):
            for message in decoder.feed(data):
                match message:
                    case Loaded(pids):
                        self._pids, self.load_failure = pids, None
                        self._hosted.set()
                        self._hosted_or_refused.set()
                    case LoadFailed(reason):
                        self.load_failure = reason
                        self._hosted_or_refused.set()
                    case Answered(number, answer) if (waiting := self._answers.get(number)) and not waiting.done():
                        waiting.set_result(answer)

    def _disconnect(self) -> None:
        """Answer open requests: the host has ended, or this server does."""
        if self._writer is not None:
            self._writer.close()
        self._writer, self._pids = None, ()
        self._scenes = SceneSender(self._write, self._drain)
        self._hosted.clear()
        for waiting in self._answers.values():
            if not waiting.done():
                waiting.set_result(PlanningFailure(MoveItErrorCode.CRASH, "the shared planners ended meanwhile"))
