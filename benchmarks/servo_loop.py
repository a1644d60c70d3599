"""How late the servo loop's ticks start, with the machine at rest and with planners busy on every core."""

from __future__ import annotations

import asyncio
import contextlib

import uvloop

from benchmarks.figures import percentiles, print_table
from benchmarks.planning import blocked_problem
from planners.pool import PlannerPool
from robot import model
from robot.arm import Arm
from robot.calibration import Calibration
from robot.limits import within_calibration
from robot.messages import ArmConfig, ArmState, Mode
from server.config import EmulatorSettings
from server.emulated_bus import EmulatedBus

SECONDS = 10.0
PLANNERS = 2

SEARCHED = blocked_problem(0, attempts=20)


def run() -> None:
    """Drive the emulated arm and gather the lateness that its states tell."""
    print_table(
        "Servo loop at 100 Hz: start of ticks after their deadline [ms]",
        ["machine", "ticks", "p50", "p99", "max"],
        uvloop.run(_measure()),
    )


async def _measure() -> list[list[str]]:
    calibration = Calibration.nominal()
    robot = within_calibration(model.builtin(), calibration)
    states: list[ArmState] = []
    bus = EmulatedBus(EmulatorSettings(), None)
    arm = Arm(ArmConfig(robot, calibration, await bus.start()), states.append)
    await arm.start(10.0)
    if arm.state.mode is Mode.DISCONNECTED:
        raise RuntimeError(arm.state.reason)
    pool = PlannerPool(robot, PLANNERS)
    await pool.start()
    await asyncio.gather(*(pool.ask(SEARCHED) for _ in range(PLANNERS + 1)))
    rows = [await _watch("at rest", states)]
    planning = asyncio.gather(*(_plan_for_ever(pool) for _ in range(PLANNERS)))
    rows.append(await _watch(f"{PLANNERS} planners busy", states))
    planning.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await planning
    await arm.close()
    await pool.close()
    await bus.close()
    return rows


async def _watch(machine: str, states: list[ArmState]) -> list[str]:
    states.clear()
    await asyncio.sleep(SECONDS)
    lateness_s = [value for state in states for value in state.lateness_s]
    return [machine, str(len(lateness_s)), *percentiles(lateness_s, 50, 99, 100)]


async def _plan_for_ever(pool: PlannerPool) -> None:
    while True:
        await pool.ask(SEARCHED)
