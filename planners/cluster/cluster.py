"""The workers of a Dask cluster as members of a pool of planners, for as long as its scheduler is in reach."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import time
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from planners.cluster.cluster_worker import ClusterWorker
from planners.cluster.contract import contract
from planners.cluster.link import Link
from planners.cluster.roster import Roster
from planners.pool import PlannerPool
from robot.description.model import RobotModel

log = logging.getLogger("armbridge.cluster")

# A scheduler answers within milliseconds.
CONNECT_TIMEOUT_S = 3.0
ANSWER_TIMEOUT_S = 10.0

# How often the scheduler is asked who its workers are; a lost connection is noticed within this time too.
WATCH_PERIOD_S = 0.5

# Between attempts to reach the scheduler.
RECONNECT_PAUSE_S = 5.0

# Leaving takes no longer, whatever Dask waits for.
CLOSE_TIMEOUT_S = 0.3

# Requests in work on the cluster at the same time, however many threads it has.
MAX_IN_WORK = 64


@dataclass(frozen=True)
class TlsFiles:
    """Files in PEM by which scheduler, workers and server know each other."""

    authority: Path
    certificate: Path
    key: Path


class Cluster:
    """Brings a cluster's workers into a pool and takes them out again.

    Args:
        address: of the scheduler, as in ``tcp://host:8786``.
        robot: the arm to plan for.
        memory_limit_bytes: what each planner process there may use for data.
        pool: what they join.
        tls: the certificates, for an address with ``tls://``.

    Attributes:
        problem: why nothing is planned there; None while something can be.
    """

    def __init__(
        self, address: str, robot: RobotModel, memory_limit_bytes: int, pool: PlannerPool, tls: TlsFiles | None = None
    ) -> None:
        self._address = address
        self._robot = robot
        self._memory_limit_bytes = memory_limit_bytes
        self._pool = pool
        self._tls = tls
        self._workers: list[ClusterWorker] = []
        self._task: asyncio.Task[None] | None = None
        self._told = ""
        self.problem: str | None = "not connected yet"

    def start(self) -> None:
        """Connect in the background, again and again."""
        self._task = asyncio.create_task(self._stay_connected(), name="planning cluster")

    async def close(self) -> None:
        """Leave the cluster."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task], timeout=CLOSE_TIMEOUT_S)

    async def _stay_connected(self) -> None:
        # Takes half a second and 40 MB, which only those pay who have a cluster, and not at the start.
        await asyncio.to_thread(importlib.import_module, "distributed")
        # Reads a hundred files, which is longer than the event loop may be held.
        await asyncio.to_thread(contract)
        # It tells of each attempt with pages of tracebacks; what matters is told here.
        for name in ("distributed", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        while True:
            try:
                async with self._connection() as link:
                    await self._watch(link)
            except (OSError, TimeoutError, ImportError) as error:
                # Its text has the local port, another one each time.
                self._tell(type(error).__name__, str(error) or type(error).__name__)
            except Exception as error:
                if type(error).__name__ != self._told:
                    log.exception("the connection to the planning cluster %s failed", self._address)
                self._tell(type(error).__name__, f"{type(error).__name__}: {error}")
            await asyncio.sleep(RECONNECT_PAUSE_S)

    @contextlib.asynccontextmanager
    async def _connection(self) -> AsyncIterator[Link]:
        from distributed import Client
        from distributed.security import Security

        security = None
        if self._tls is not None:
            security = Security(
                require_encryption=True,
                tls_ca_file=str(self._tls.authority),
                tls_client_cert=str(self._tls.certificate),
                tls_client_key=str(self._tls.key),
            )
        client = Client(
            self._address,
            asynchronous=True,
            set_as_default=False,
            timeout=CONNECT_TIMEOUT_S,
            security=security,
            name="armbridge",
        )
        link = Link(client, self._robot, self._memory_limit_bytes)
        try:
            await client
            yield link
        finally:
            await link.close()

    async def _watch(self, link: Link) -> None:
        """Follow who is there until the scheduler is lost."""
        roster = Roster(link.recruit)
        try:
            while link.open:
                roster.see(await link.threads(ANSWER_TIMEOUT_S), time.monotonic())
                self._staff(link, roster.members)
                if not roster.members and not roster.busy:
                    self._tell("no worker", "it has no worker that can plan for this server")
                await asyncio.sleep(WATCH_PERIOD_S)
        finally:
            self._staff(link, {})
            await roster.close()
        raise ConnectionError("the scheduler is gone")

    def _staff(self, link: Link, members: Mapping[str, int]) -> None:
        """Have as many workers in the pool as the cluster has room."""
        link.members = list(members)
        count = min(sum(members.values()), MAX_IN_WORK)
        if count and count != len(self._workers):
            where = f"{self._address} plans up to {count} goals at the same time, on {len(members)} of its workers"
            log.info("the planning cluster %s", where)
        while len(self._workers) > count:
            self._pool.remove(self._workers.pop())
        while len(self._workers) < count:
            self._workers.append(ClusterWorker(link))
            self._pool.add(self._workers[-1])
        if count:
            self._told, self.problem = "", None

    def _tell(self, kind: str, problem: str) -> None:
        """Log a kind of problem once, however often it is met in a row."""
        if kind != self._told:
            log.warning("nothing is planned on the cluster %s: %s; planning goes on here", self._address, problem)
        self._told, self.problem = kind, problem
