"""A Dask cluster's part in a pool of planners: room for one request."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import TYPE_CHECKING, Any

from planners.cluster.link import Link
from planners.cluster.messages import Missing
from planners.problem import Answer, MoveItErrorCode, PlanningFailure, Request
from planners.scene import Scene
from planners.worker_process import ANSWER_TO

if TYPE_CHECKING:
    from distributed import Future

log = logging.getLogger("armbridge.cluster")

# A worker that lacks robot or scene gets it; one that lacks it again and again is restarted all the time.
MAX_TRIES = 4

# Taking a task back is a message to the scheduler, no wait for an answer.
CANCEL_TIMEOUT_S = 1.0


class ClusterWorker:
    """Room for one request on a cluster; which of its workers gets it, the scheduler decides.

    Args:
        link: to the scheduler. When that is gone this takes no request any more, nor ever again.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._future: Future[Any] | None = None

    @property
    def takes_questions(self) -> bool:
        """They would be longer on their way than in work."""
        return False

    @property
    def usable(self) -> bool:
        """Whether the scheduler is in reach."""
        return self._link.open

    def run_delay_s(self) -> float | None:
        """Tell nothing: the waits are on other machines."""
        return None

    def has(self, scene: Scene) -> bool:  # noqa: ARG002 - the signature of PlanningWorker
        """A scene is sent when the chosen worker turns out to lack it."""
        return False

    async def ask(self, request: Request, scene: Scene) -> Answer:
        """Have the cluster answer a request; see :class:`planners.planning_worker.PlanningWorker`."""
        from distributed import CancelledError as TakenBack
        from distributed import KilledWorker

        try:
            return await self._ask(request, scene)
        except (OSError, TimeoutError, TakenBack) as error:
            message = f"the planning cluster went out of reach: {str(error) or type(error).__name__}"
            return PlanningFailure(MoveItErrorCode.COMMUNICATION_FAILURE, message)
        except KilledWorker as error:
            message = f"{error.allowed_failures + 1} workers of the cluster ended while they worked on this"
            return PlanningFailure(MoveItErrorCode.CRASH, message)
        except Exception as error:
            # What comes of another machine must not end the goal's task without an answer.
            log.exception("planning on the cluster failed")
            message = f"planning on the cluster failed: {type(error).__name__}: {error}"
            return PlanningFailure(MoveItErrorCode.CRASH, message)

    async def cancel(self) -> None:
        """Take the task back; its worker notices within some 20 ms."""
        future, self._future = self._future, None
        if future is not None and not future.done() and self._link.open:
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(CANCEL_TIMEOUT_S):
                    await future.cancel()

    async def kill(self) -> None:
        """The same: what runs on the worker is ended there, by force if it does not listen."""
        await self.cancel()

    async def _ask(self, request: Request, scene: Scene) -> Answer:
        worker = None
        for _ in range(MAX_TRIES):
            self._future = self._link.submit(request, scene, worker)
            answer = await self._future.result()
            # Until it is released the cluster keeps the answer.
            self._future = None
            if isinstance(answer, ANSWER_TO[type(request)] | PlanningFailure):
                return answer
            if not isinstance(answer, Missing):
                message = f"the cluster answered a {type(request).__name__} with {type(answer).__name__}"
                return PlanningFailure(MoveItErrorCode.CRASH, message)
            worker = answer.worker
            await self._link.supply(answer, scene)
        message = f"a worker of the cluster lacked robot or scene {MAX_TRIES} times in a row"
        return PlanningFailure(MoveItErrorCode.COMMUNICATION_FAILURE, message)
