"""Run of the arm process on an emulated bus: motions one after the other, with the scenario's faults."""

import asyncio
import contextlib
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from harness.emulator import RunningEmulator
from harness.waiting import TIMEOUT_S, until
from harness.write_log import Entry, read_entries
from robot.description.limits import within_calibration
from robot.description.robot_folder import built_in
from robot.hardware.config import SerialConfig
from robot.hardware.interface import StatusFlag
from robot.messages import RELAXING_ARM, ArmConfig, ArmState, EndState, Mode, Order, Outcome
from tests.helpers.arm_contract import Watched
from tests.helpers.motions import smooth_move
from tests.processes.campaign import checks
from tests.processes.campaign.scenario import (
    CALIBRATION,
    MOVING_S,
    NAMES,
    REFUSED,
    START_RAD,
    Event,
    Result,
    Scenario,
    calm,
    random_goal,
)

ROBOT = within_calibration(built_in("so101").model, CALIBRATION)

# Between a fault and the try to reset it.
LOOK_S = 0.1

STOP_SHARE = 0.2
GRIP_SHARE = 0.3
WRONG_SHARE = 0.1

DURATIONS_S = (0.6, 1.4)


@dataclass
class CampaignBus:
    """A running emulator; ``port`` is the name under which the adapter is found again after it was unplugged."""

    emulator: RunningEmulator
    log: Path
    port: str

    def tell(self, command: Mapping[str, object]) -> None:
        """Send one live command."""
        answer = self.emulator.command(**command)
        if "error" in answer:
            raise ValueError(str(answer["error"]))

    def calm(self, scenario: Scenario) -> None:
        """End every fault; an overload that stays latched otherwise needs the supply off and on."""
        for command in calm(scenario.servos):
            self.tell(command)
        overloaded = any(status & StatusFlag.OVERLOAD for status in self.entries()[-1].status.values())
        if scenario.servos.overload_latches and overloaded:
            self.tell({"power_cycle": NAMES})

    def entries(self) -> list[Entry]:
        """Return the log up to now; its last entry has the present state of the servos."""
        self.tell({})
        return read_entries(self.log)


@contextmanager
def campaign_bus(scenario: Scenario, folder: Path) -> Iterator[CampaignBus]:
    """Start an emulator for a run; its log stays in the folder."""
    # The link bears the process's id: one seed run twice at a time in one folder must not meet on one bus.
    log, link = folder / f"seed-{scenario.seed}.jsonl", folder / f"bus-{scenario.seed}-{os.getpid()}"
    start = ",".join(str(position) for position in START_RAD)
    drawn = f"--start={start}", "--seed", str(scenario.seed), "--population", scenario.population
    emulator = RunningEmulator("--write-log", str(log), "--link", str(link), *drawn)
    try:
        yield CampaignBus(emulator, log, str(link))
    finally:
        emulator.end()


@dataclass
class ArmRun:
    """One run, and the spans in which the servos' goals may change."""

    scenario: Scenario
    bus: CampaignBus
    arm: Watched
    result: Result
    chance: random.Random
    licensed: list[checks.Span] = field(default_factory=list)
    resets: int = 0

    async def play(self) -> None:
        """Move, inject the faults, recover, end."""
        await self.arm.start(TIMEOUT_S)
        await until(lambda: self.arm.state.mode is Mode.HOLDING)
        await self._operate()
        if self.scenario.calmed:
            await self._recover()
        await self._end()

    async def insist(self) -> None:
        """Ask for torque again and again while the faults happen, and after them."""
        await self.arm.start(TIMEOUT_S)
        await self._operate()
        self.bus.calm(self.scenario)
        for order in (Order.RESET_FAULT, Order.ENABLE):
            await self._order(order)

    async def _operate(self) -> None:
        """Inject the faults, and act as an operator meanwhile."""
        self.bus.tell(self.scenario.wire)
        befalling = asyncio.create_task(self._befall(self.scenario.events))
        until_s = time.monotonic() + MOVING_S
        while time.monotonic() < until_s:
            await self._go_on()
        await befalling

    async def _befall(self, events: tuple[Event, ...]) -> None:
        started_s = time.monotonic()
        for event in events:
            await asyncio.sleep(event.at_s - (time.monotonic() - started_s))
            if event.command:
                self.bus.tell(event.command)
            if event.order is not None:
                await self._order(event.order)
            if event.kills_arm and self.arm.pid is not None:
                os.kill(self.arm.pid, signal.SIGKILL)

    async def _go_on(self) -> None:
        """Act as an operator: move an arm that holds, reset a fault, enable an arm that is relaxed."""
        mode = self.arm.state.mode
        if mode is Mode.HOLDING:
            if await self._move() is not Outcome.REFUSED:
                return
        elif mode in (Mode.FAULT, Mode.RELAXED):
            await self._order(Order.RESET_FAULT if mode is Mode.FAULT else Order.ENABLE)
        await asyncio.sleep(LOOK_S)

    async def _move(self) -> Outcome | None:
        goal_rad = self.arm.state.goal_rad
        if goal_rad is None:
            return None
        held = dict(zip(self.arm.state.joint_names, goal_rad.tolist(), strict=True))
        wrong = 2.5 if self.chance.random() < WRONG_SHARE else 0.0
        moves = {name: (held[name], target + wrong) for name, target in random_goal(self.chance).items()}
        duration_s = self.chance.uniform(*DURATIONS_S)
        gripping = "gripper" in moves and self.chance.random() < GRIP_SHARE
        started_s = time.monotonic()
        motion = self.arm.execute(smooth_move(moves, duration_s), gripping=gripping)
        if self.chance.random() < STOP_SHARE:
            await asyncio.wait([motion], timeout=self.chance.uniform(0.0, duration_s))
            self.arm.stop()
        try:
            ended = await asyncio.wait_for(motion, TIMEOUT_S)
        except TimeoutError:
            self.result.violations.append("a motion had no answer")
            return None
        self._license(started_s)
        return ended.outcome

    async def _order(self, order: Order) -> bool:
        started_s = time.monotonic()
        done = await self.arm.order(order)
        self._license(started_s)
        self.resets += order is Order.RESET_FAULT and done.done
        if "did not answer" in done.message:
            self.result.violations.append(f"{order.value}: {done.message}")
        return done.done

    async def _recover(self) -> None:
        """Check that the arm recovers and moves again once the faults have ended."""
        self.bus.calm(self.scenario)
        until_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() < until_s:
            if self.arm.state.mode is Mode.HOLDING and await self._move() is Outcome.REACHED:
                return
            await self._go_on()
        state = self.arm.state
        self.result.violations.append(
            f"the arm did not recover: {state.mode.value}, {state.fault or state.reason or 'no reason'}"
        )

    async def _end(self) -> None:
        """End the arm process, during a motion if it moves, and check the state of the arm."""
        mode, before = self.arm.state.mode, len(self.arm.states)
        started_s = time.monotonic()
        held = mode is Mode.HOLDING and self.chance.random() < 0.5
        moving = asyncio.create_task(self._move()) if held else None
        await asyncio.sleep(0.1)
        await self.arm.close()
        self._license(started_s)
        if moving is not None:
            await moving
        # A busy machine may keep this process from its heartbeat, and the arm relaxes if it is to without a server.
        relaxes = any(state.task == RELAXING_ARM for state in self.arm.states[before:])
        if relaxes and self.scenario.on_server_lost is EndState.RELAX:
            mode = Mode.RELAXED
        self.result.violations += _end_state(self.bus.entries(), mode, self.scenario)

    def _license(self, started_s: float) -> None:
        self.licensed.append(checks.Span(started_s, time.monotonic() + checks.HEARD_LATE_S))


def _end_state(entries: list[Entry], mode: Mode, scenario: Scenario) -> list[str]:
    """Check that an arm without a fault is in its configured end state."""
    torque = set(entries[-1].torque.values())
    if mode is Mode.HOLDING and scenario.on_exit is EndState.HOLD and torque != {1}:
        return [f"the arm was to hold at the end, but its torque is {entries[-1].torque}"]
    if (mode is Mode.RELAXED or (mode is Mode.HOLDING and scenario.on_exit is EndState.RELAX)) and torque != {0}:
        return [f"the arm was to be relaxed at the end, but its torque is {entries[-1].torque}"]
    return []


async def run_arm(scenario: Scenario, folder: Path) -> Result:
    """Run a scenario of the arm process; some servos must not be given torque, whatever happens and is asked for."""
    result = Result(scenario.seed, scenario.happening.value, scenario.population)
    refused = scenario.population in REFUSED
    with campaign_bus(scenario, folder) as bus:
        config = ArmConfig(
            ROBOT,
            SerialConfig(CALIBRATION, bus.port),
            on_exit=scenario.on_exit,
            on_server_lost=scenario.on_server_lost,
            on_emergency_stop=scenario.on_emergency_stop,
        )
        arm = Watched(config)
        run = ArmRun(scenario, bus, arm, result, random.Random(scenario.seed))
        try:
            await (run.insist() if refused else run.play())
        finally:
            with contextlib.suppress(ProcessLookupError):
                await arm.close()
        entries = bus.entries()
    result.writes, result.states = len(entries), len(arm.states)
    result.violations += _answered_once(arm)
    if refused:
        result.violations += checks.never_driven(entries)
        if not any(state.mode is not Mode.DISCONNECTED or state.reason for state in arm.states):
            result.violations.append("no state said why the arm has no torque")
        return result
    wall_minus_monotonic_s = time.time() - time.monotonic()
    licensed = [*run.licensed, *_minding(arm.states, wall_minus_monotonic_s)]
    result.violations += [
        *checks.goal_steps(entries),
        *checks.limits(entries),
        *checks.torque_on(entries),
        *checks.unasked_motion(entries, licensed),
        *checks.readings(entries, arm.states, wall_minus_monotonic_s),
        *checks.latched_faults(arm.states, run.resets),
    ]
    return result


def _minding(states: list[ArmState], wall_minus_monotonic_s: float) -> list[checks.Span]:
    """Return the spans in which the arm had a fault, which lets it give way, or was connecting, which adopts goals."""
    return [
        checks.Span(at_s - checks.HEARD_LATE_S, at_s + checks.HEARD_LATE_S)
        for state in states
        if state.mode not in (Mode.HOLDING, Mode.MOVING, Mode.RELAXED)
        for at_s in [state.stamp_s - wall_minus_monotonic_s]
    ]


def _answered_once(arm: Watched) -> list[str]:
    """Check that no motion and no order was answered twice."""
    answers = Counter(f"motion {ended.motion_id}" for ended in arm.ended)
    answers += Counter(f"order {done.number}" for done in arm.done)
    return [f"{name} was answered {count} times" for name, count in sorted(answers.items()) if count > 1]
