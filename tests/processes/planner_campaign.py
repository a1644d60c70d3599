"""``python -m tests.processes.planner_campaign``: random faults in the planner processes of one pool.

Each round requests a motion, injects a fault, and then requests a motion that must be planned, with the same result as
without a fault; a fault may cost one motion, not two. Ends with a table, or with the first round that broke the pool.
"""

import argparse
import asyncio
import os
import random
import signal
import time
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable

import numpy as np
import psutil
import uvloop

from harness.figures import percentiles, print_table
from planners import pool as planner_pool
from planners.interface import LOAD_TIMEOUT_S
from planners.pool import OVERTIME_S, PlannerPool
from planners.problem import Answer, Plan, PlanningFailure, PlanningProblem
from robot.description.robot_folder import built_in
from tests.helpers.broken_planner import FAULTS
from tests.helpers.motions import EASY, LONG, STATE, broken

MEMORY_LIMIT_BYTES = 300_000_000

# A worker is replaced in a second; for one that is stopped while it loads the pool waits its whole time limit.
RECOVERY_TIMEOUT_S = LOAD_TIMEOUT_S + 30.0

# A fault takes as long as a hang at most, and these end a grace period after the allowed time; before that, a worker
# may have to be started.
ALLOWED_TIME_S = 0.3
FAULT_TIMEOUT_S = RECOVERY_TIMEOUT_S + ALLOWED_TIME_S + OVERTIME_S

# Open files and memory may vary by this much without a leak.
SPARE_FILES = 4
SPARE_BYTES = 30e6

SUCCESS = "SUCCESS"
SIGNALS = (signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGTERM, signal.SIGABRT)


class Campaign:
    """Random faults in one pool.

    Args:
        pool: pool that has been started.
        rng: source of the random choices.
    """

    def __init__(self, pool: PlannerPool, rng: random.Random) -> None:
        self._pool = pool
        self._rng = rng
        self._expected: Plan | None = None
        self.codes: dict[str, Counter[str]] = defaultdict(Counter)
        self.recovery_s: dict[str, list[float]] = defaultdict(list)

    async def round(self) -> None:
        """Inject one fault, and check the pool after it."""
        faults: list[tuple[str, Callable[[], Awaitable[str]]]] = [
            *((fault, lambda fault=fault: self._ask(broken(fault, ALLOWED_TIME_S))) for fault in FAULTS),
            ("cancelled", self._cancelled),
            *((number.name, lambda number=number: self._signalled(number)) for number in SIGNALS),
            ("all " + signal.SIGKILL.name, self._all_killed),
        ]
        name, fault = self._rng.choice(faults)
        code = await asyncio.wait_for(fault(), FAULT_TIMEOUT_S)
        started_s = time.monotonic()
        if code == SUCCESS:
            # The fault hit an idle worker; the next motion may be given to that one.
            code = _code(await self._pool.ask(_brief(EASY)))
        self.codes[name][code] += 1
        await asyncio.wait_for(self._check(), RECOVERY_TIMEOUT_S)
        self.recovery_s[name].append(time.monotonic() - started_s)

    async def _check(self) -> None:
        plan = await self._pool.ask(EASY)
        if not isinstance(plan, Plan):
            raise TypeError(f"an easy motion was answered with {plan}")
        self._expected = self._expected or plan
        if not np.array_equal(plan.trajectory.positions_rad, self._expected.trajectory.positions_rad):
            raise ValueError("an easy motion was planned in another way than before")

    async def _ask(self, problem: PlanningProblem) -> str:
        return _code(await self._pool.ask(problem))

    async def _cancelled(self) -> str:
        problem = self._rng.choice([LONG, broken(self._rng.choice(list(FAULTS)))])
        asking = asyncio.create_task(self._pool.ask(problem))
        await asyncio.wait([asking], timeout=self._rng.uniform(0.0, 0.1))
        asking.cancel()
        await asyncio.wait([asking])
        return "cancelled" if asking.cancelled() else _code(asking.result())

    async def _signalled(self, number: signal.Signals) -> str:
        asking = asyncio.create_task(self._pool.ask(_brief(LONG)))
        await asyncio.wait([asking], timeout=self._rng.uniform(0.0, 0.2))
        os.kill(self._rng.choice(self._pool.pids), number)
        return _code(await asking)

    async def _all_killed(self) -> str:
        asking = asyncio.gather(self._pool.ask(_brief(LONG)), self._pool.ask(STATE))
        await asyncio.wait([asking], timeout=self._rng.uniform(0.0, 0.1))
        for pid in self._pool.pids:
            os.kill(pid, signal.SIGKILL)
        return _code((await asking)[0])


def _brief(problem: PlanningProblem) -> PlanningProblem:
    return PlanningProblem(
        problem.group, problem.start_rad, problem.goal, allowed_time_s=ALLOWED_TIME_S, attempts=problem.attempts
    )


def _code(answer: Answer) -> str:
    return answer.code.name if isinstance(answer, PlanningFailure) else SUCCESS


async def _run(seconds: float, seed: int) -> None:
    planner_pool.WORKER_MODULE = "tests.helpers.broken_planner"
    pool = PlannerPool(built_in("so101").model, memory_limit_bytes=MEMORY_LIMIT_BYTES)
    campaign = Campaign(pool, random.Random(seed))
    process = psutil.Process()
    await pool.start()
    try:
        await campaign.round()
        files, memory = process.num_fds(), process.memory_info().rss
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            await campaign.round()
        async with asyncio.timeout(RECOVERY_TIMEOUT_S):
            while pool.idle_count < len(pool.pids):
                await asyncio.sleep(0.05)
        grown_files, grown_bytes = process.num_fds() - files, process.memory_info().rss - memory
    finally:
        _report(campaign)
        await pool.close()
    left = len(process.children())
    print(f"\nOpen files {grown_files:+d}, memory {grown_bytes / 1e6:+.1f} MB, children left: {left}")
    if grown_files > SPARE_FILES or grown_bytes > SPARE_BYTES or left:
        raise SystemExit("the server's process holds more than it should")


def _report(campaign: Campaign) -> None:
    rows = [
        [
            name,
            ", ".join(f"{code} {count}" for code, count in campaign.codes[name].items()),
            *percentiles(campaign.recovery_s[name], 50, 100),
        ]
        for name in sorted(campaign.codes)
    ]
    print_table(
        "Planner processes: faults, their answers, and the time to the next plan [ms]",
        ["fault", "answers", "next plan p50", "max"],
        rows,
    )


def main() -> None:
    """Run rounds for the time that the command line gives."""
    parser = argparse.ArgumentParser(prog="python -m tests.processes.planner_campaign", description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="for so long (120)")
    parser.add_argument("--seed", type=int, default=1, help="of the choice of faults (1)")
    options = parser.parse_args()
    uvloop.run(_run(options.seconds, options.seed))


if __name__ == "__main__":
    main()
