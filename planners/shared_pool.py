"""Planners that several servers share, as one of them sees them: a connection to :mod:`planners.pool_host`."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import logging
import time
from pathlib import Path

from planners.messages import Answered, Ask, Cancel, Hosted, LoadFailed, MoreObjects, NewScene
from planners.pool import LOAD_TIMEOUT_S, PlannerPool, parts
from planners.pool_host import LONGEST_PLANNING_S, READ_BYTES
from planners.problem import Answer, MoveItErrorCode, Plan, PlanningFailure, PlanningProblem, Request
from planners.scene import EMPTY_SCENE, Scene
from robot.channel import Decoder, encode
from robot.description.model import RobotModel
from robot.processes import RestartDelay

log = logging.getLogger("armbridge.planners")

# Rounds that a request may wait for its turn, each of the longest planning: the host itself answers long before.
ROUNDS = 6
ANSWER_TIMEOUT_S = ROUNDS * LONGEST_PLANNING_S


class SharedPlanners(PlannerPool):
    """Pool without processes of its own: one motion and one question at a time go to the host.

    Args:
        robot: the arm to plan for, which is the host's.
        address: path of the host's socket.
    """

    def __init__(self, robot: RobotModel, address: Path) -> None:
        super().__init__(robot)
        self._address = address
        self._numbers = itertools.count(1)
        self._answers: dict[int, asyncio.Future[Answer]] = {}
        self._pids: tuple[int, ...] = ()
        self._hosted = asyncio.Event()
        self._told = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._sending = asyncio.Lock()
        self._sent_version = EMPTY_SCENE.version
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
        await self._told.wait()
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

    async def ask_in_background(
        self, problem: PlanningProblem, scene: Scene = EMPTY_SCENE
    ) -> Plan | PlanningFailure | None:
        """Plan nothing: the host's planners are those of others as well, whose requests would have to wait."""
        del problem, scene
        return None

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
                await self._send(Ask(number, request), scene)
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

    async def _send(self, ask: Ask, scene: Scene) -> None:
        """Send a request, after its scene unless the host has it; in parts, between which the event loop has turns."""
        async with self._sending:
            if scene.version != self._sent_version:
                # Unknown while it is under way: one given up half-way is begun anew.
                self._sent_version = -1
                self._write(NewScene(dataclasses.replace(scene, objects=())))
                for objects in parts(scene.objects):
                    self._write(MoreObjects(objects))
                    if self._writer is not None:
                        with contextlib.suppress(OSError):
                            await self._writer.drain()
                self._sent_version = scene.version
            self._write(ask)

    def _write(self, message: object) -> None:
        if self._writer is not None:
            self._writer.write(encode(message))

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
                    case Hosted(pids):
                        self._pids, self.load_failure = pids, None
                        self._hosted.set()
                        self._told.set()
                    case LoadFailed(reason):
                        self.load_failure = reason
                        self._told.set()
                    case Answered(number, answer) if (waiting := self._answers.get(number)) and not waiting.done():
                        waiting.set_result(answer)

    def _disconnect(self) -> None:
        """Answer what is under way: the host has ended, or this server does."""
        if self._writer is not None:
            self._writer.close()
        self._writer, self._pids, self._sent_version = None, (), EMPTY_SCENE.version
        self._hosted.clear()
        for waiting in self._answers.values():
            if not waiting.done():
                waiting.set_result(PlanningFailure(MoveItErrorCode.CRASH, "the shared planners ended meanwhile"))
