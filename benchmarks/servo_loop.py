"""Arm process: lateness of its ticks, CPU time, and latency from a stop to the servos.

All of it on the emulated bus, whose log has the time of each write to a servo, on the same clock as this process.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import psutil
import uvloop

from benchmarks.planning import blocked_problem
from harness.clients import ArmClient, arm_client, values_of
from harness.emulator import RunningEmulator
from harness.figures import percentiles, print_table
from harness.server import RunningServer
from harness.write_log import Entry, read_entries
from planners.pool import PlannerPool
from robot.arm import Arm
from robot.calibration import Calibration
from robot.description.limits import within_calibration
from robot.description.robot_folder import built_in
from robot.hardware.config import SerialConfig
from robot.messages import ArmConfig, ArmHealth, ArmState, Mode, MotionEnded
from robot.trajectory import PERIOD_S, rest_to_rest

CALIBRATION = replace(Calibration.nominal(built_in("so101").hardware.servos), measured=True)
ROBOT = within_calibration(built_in("so101").model, CALIBRATION)

SECONDS = 10.0
START_TIMEOUT_S = 15.0
PLANNERS = 2
SEARCHED = blocked_problem(0, attempts=20)

# Three writes of goals within one period are a burst: missed ticks that were made up for. A late tick and the punctual
# one after it are two.
BURST, BURST_S = 3, PERIOD_S

MISSING_SERVO = 6

LOOP_HEADER = (
    *("arm and machine", "ticks", "late p50", "p99", "max"),
    *("bursts", "block read p50", "p99", "max", "CPU % of a core"),
)

# Stops of a joint without weight, in the midst of its motion at its full speed: 13 ticks of the servo a cycle.
STOPS = 40
JOINT, SERVO = "wrist_roll", 5
REACH_RAD, SPEED_RAD_S, ACCELERATION_RAD_S2 = 1.5, 2.0, 8.0
FIRST_STOP_S, LAST_STOP_S = 0.5, 1.1
SLOWER_TICKS = 12

EMERGENCY_STOPS = 20
RECOVERY_S = 15.0
FLOOD_S = 600.0


@dataclass
class Rig:
    """Arm process on an emulator."""

    emulator: RunningEmulator
    log: Path
    states: list[ArmState] = field(default_factory=list)
    healths: list[ArmHealth] = field(default_factory=list)
    arm: Arm = field(init=False)

    async def start(self) -> None:
        """Start the arm process and wait until it holds."""
        config = ArmConfig(ROBOT, SerialConfig(CALIBRATION, self.emulator.port))
        self.arm = Arm(config, self.states.append, self.healths.append)
        await self.arm.start(START_TIMEOUT_S)
        if self.arm.state.mode is not Mode.HOLDING:
            raise RuntimeError(f"the arm does not hold: {self.arm.state}")


def run() -> None:
    """Drive the emulated arm, and stop it in every way."""
    print_table(
        f"Servo loop at 100 Hz, {SECONDS:g} s each [ms]",
        LOOP_HEADER,
        uvloop.run(_watch_loop()),
    )
    print_table(
        "From an order to the servos [ms]",
        ["order", "times", "p50", "p99", "max"],
        [uvloop.run(_stops()), *uvloop.run(_emergency_stops())],
    )


@contextlib.contextmanager
def _emulator() -> Iterator[Rig]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "writes.jsonl"
        emulator = RunningEmulator("--write-log", str(log))
        try:
            yield Rig(emulator, log)
        finally:
            emulator.end()


async def _watch_loop() -> list[list[str]]:
    with _emulator() as rig:
        await rig.start()
        pool = PlannerPool(ROBOT, PLANNERS)
        await pool.start()
        await asyncio.gather(*(pool.ask(SEARCHED) for _ in range(PLANNERS + 1)))
        rows = [await _watch("all servos, machine as it is", rig)]
        planning = asyncio.gather(*(_plan_for_ever(pool) for _ in range(PLANNERS)))
        rows.append(await _watch(f"all servos, {PLANNERS} planners busy", rig))
        planning.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await planning
        rig.emulator.command(offline=[MISSING_SERVO])
        rows.append(await _watch("one servo missing", rig))
        await rig.arm.close()
        await pool.close()
    return rows


async def _watch(name: str, rig: Rig) -> list[str]:
    process = psutil.Process(rig.arm.pid)
    process.cpu_percent()
    rig.states.clear()
    rig.healths.clear()
    from_s = time.monotonic()
    await asyncio.sleep(SECONDS)
    cpu = process.cpu_percent()
    lateness_s = [value for state in rig.states for value in state.lateness_s]
    trips_s = np.array([health.round_trip_s for health in rig.healths]) * 1e3
    trips = [f"{trips_s[:, 0].mean():.2f}", f"{trips_s[:, 1].mean():.2f}", f"{trips_s[:, 2].max():.2f}"]
    late = percentiles(lateness_s, 50, 99, 100)
    return [name, str(len(lateness_s)), *late, str(_bursts(rig.log, from_s)), *trips, f"{cpu:.1f}"]


def _bursts(log: Path, from_s: float) -> int:
    times_s = [entry.at_s for entry in read_entries(log) if entry.at_s > from_s and _tells_goals(entry)]
    return sum(last - first < BURST_S for first, last in zip(times_s, times_s[BURST - 1 :], strict=False))


def _tells_goals(entry: Entry) -> bool:
    return any("GOAL_POSITION" in registers for registers in entry.written.values())


async def _plan_for_ever(pool: PlannerPool) -> None:
    while True:
        await pool.ask(SEARCHED)


async def _stops() -> list[str]:
    chance = np.random.default_rng(0)
    told_s = []
    with _emulator() as rig:
        await rig.start()
        await _move(rig, -REACH_RAD)
        for number in range(STOPS):
            motion = _move(rig, REACH_RAD if number % 2 == 0 else -REACH_RAD)
            await asyncio.sleep(chance.uniform(FIRST_STOP_S, LAST_STOP_S))
            told_s.append(time.monotonic())
            rig.arm.stop()
            await motion
            await _move(rig, REACH_RAD if number % 2 == 0 else -REACH_RAD)
        await rig.arm.close()
        entries = [entry for entry in read_entries(rig.log) if _tells_goals(entry)]
    latencies_s = [_slower_s(entries, at_s) - at_s for at_s in told_s]
    return ["stop, to the first slower goal", str(STOPS), *percentiles(latencies_s, 50, 99, 100)]


def _move(rig: Rig, target_rad: float) -> asyncio.Future[MotionEnded]:
    state = rig.arm.state
    if state.goal_rad is None:
        raise RuntimeError(f"the arm cannot be moved: {state.reason}")
    held_rad = float(state.goal_rad[state.joint_names.index(JOINT)])
    return rig.arm.execute(rest_to_rest(JOINT, held_rad, target_rad, SPEED_RAD_S, ACCELERATION_RAD_S2))


def _slower_s(entries: Iterable[Entry], told_s: float) -> float:
    """Return the first time after a moment at which the joint's goal fell behind its cruise (monotonic [s])."""
    for before, after in itertools.pairwise(entries):
        if after.at_s > told_s and abs(after.goal[SERVO] - before.goal[SERVO]) <= SLOWER_TICKS:
            return after.at_s
    raise RuntimeError("the arm did not stop")


async def _emergency_stops() -> list[list[str]]:
    with _emulator() as rig, RunningServer(f"--port 0 --serial {rig.emulator.port} --calibration nominal") as server:
        async with arm_client(server.url) as client:
            await client.until_mode("holding")
            rows = [await _emergency_row("emergency stop of a client, machine as it is", client, rig.log)]
            async with _flood("messages", server.url):
                rows.append(await _emergency_row("the same, another client publishes without pause", client, rig.log))
            async with _flood("goals", server.url):
                rows.append(await _emergency_row("the same, another client sends goals without pause", client, rig.log))
    return rows


@contextlib.asynccontextmanager
async def _flood(kind: str, url: str) -> AsyncIterator[None]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "benchmarks.flood_clients", kind, url, f"{FLOOD_S:g}"
    )
    try:
        yield
    finally:
        process.kill()
        await process.wait()


async def _emergency_row(name: str, client: ArmClient, log: Path) -> list[str]:
    told_s = []
    for _ in range(EMERGENCY_STOPS):
        await recover(client)
        told_s.append(time.monotonic())
        await client.call("/arm/emergency_stop")
    entries = read_entries(log)
    latencies_s = [
        next(entry.at_s for entry in entries if _cuts(entry) and entry.at_s > at_s) - at_s for at_s in told_s
    ]
    return [name, str(EMERGENCY_STOPS), *percentiles(latencies_s, 50, 99, 100)]


def _cuts(entry: Entry) -> bool:
    """Return True if a write switched off the torque of a servo."""
    return 0 in entry.torque.values() and any("TORQUE_ENABLE" in registers for registers in entry.written.values())


async def recover(client: ArmClient) -> None:
    """Reset and enable the arm until it holds."""
    remedies = {"fault": "/arm/reset_fault", "relaxed": "/arm/enable"}
    async with asyncio.timeout(RECOVERY_S):
        while (mode := values_of(client.topics["/arm/state"][-1])["mode"]) not in ("holding", "moving"):
            if mode in remedies:
                await client.call(remedies[mode])
            await asyncio.sleep(0.1)
