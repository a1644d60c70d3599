"""Servoing: latency from the stick to the servos, planning time, and bound of the jerk.

All of it on the emulated bus, whose log has the time of each write to a servo, on the same clock as this process.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import uvloop

from benchmarks.planning import blocked_problem
from harness.clients import ArmClient, arm_client
from harness.emulator import RunningEmulator
from harness.figures import percentiles, print_table
from harness.server import RunningServer
from harness.write_log import Entry, read_entries
from planners.pool import PlannerPool
from planners.servo.question import ServoAnswer, ServoQuestion, TipTwist
from robot.arm import Arm
from robot.calibration import Calibration
from robot.description.limits import JointBounds, within_calibration
from robot.description.robot_folder import built_in
from robot.hardware.config import SerialConfig
from robot.messages import ArmConfig, Commanded
from robot.trajectory import PERIOD_S, TIME_TO_FULL_ACCELERATION_S

CALIBRATION = replace(Calibration.nominal(built_in("so101").hardware.servos), measured=True)
ROBOT = within_calibration(built_in("so101").model, CALIBRATION)
JOINTS = ROBOT.groups["arm"].joints
TIP = ROBOT.groups["arm"].tip_link

STROKES = 20
STROKE_S, PAUSE_S, STICK_PERIOD_S = 0.4, 1.2, 0.01

# Topic, type, and the message by the side to which the stick is held.
STICKS: Mapping[str, tuple[str, str, Callable[[float], dict[str, Any]]]] = {
    "twist, 0.1 m/s to the side": (
        "/servo_node/delta_twist_cmds",
        "geometry_msgs/TwistStamped",
        lambda side: {"twist": {"linear": {"y": 0.5 * side}}},
    ),
    "joint jog, wrist at 0.5 rad/s": (
        "/servo_node/delta_joint_cmds",
        "control_msgs/JointJog",
        lambda side: {"joint_names": ["wrist_roll"], "velocities": [side]},
    ),
}

QUESTIONS = 500
READY = {"shoulder_lift": -0.5, "elbow_flex": 0.5}
SEARCHED = blocked_problem(0, attempts=20)

WILD_S, WILD_SETPOINT_S, START_TIMEOUT_S = 10.0, 0.02, 15.0
POLL_S = 0.002


def run() -> None:
    """Measure held sticks, planning times, and random setpoints."""
    print_table(
        "From the first command of a stick to the first changed goal of a servo [ms]",
        ["stick, 100 commands a second", "times", "p50", "p99", "max"],
        uvloop.run(_sticks()),
    )
    print_table(
        "A planner's answer to who steers [ms]", ["machine", "times", "p50", "p99", "max"], uvloop.run(_answers())
    )
    print_table(
        "An arm that is steered at random, as shares of the bounds",
        ["joint", "greatest velocity", "acceleration", "jerk"],
        uvloop.run(_wild()),
    )


@contextlib.contextmanager
def _emulator() -> Iterator[tuple[RunningEmulator, Path]]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "writes.jsonl"
        emulator = RunningEmulator("--write-log", str(log))
        try:
            yield emulator, log
        finally:
            emulator.end()


async def _sticks() -> list[list[str]]:
    rows = []
    with (
        _emulator() as (emulator, log),
        RunningServer(f"--port 0 --serial {emulator.port} --calibration nominal") as server,
    ):
        async with arm_client(server.url) as client:
            await client.until_mode("holding")
            await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "ready"})
            await client.until("/moveit_goal_result", bool)
            for name, (topic, type_name, message) in STICKS.items():
                await client.say("advertise", topic=topic, type=type_name)
                begun_s = [await _stroke(client, topic, message((-1.0) ** stroke)) for stroke in range(STROKES)]
                entries = read_entries(log)
                late_s = [_changed_s(entries, at_s) - at_s for at_s in begun_s]
                rows.append([name, str(STROKES), *percentiles(late_s, 50, 99, 100)])
    return rows


async def _stroke(client: ArmClient, topic: str, message: dict[str, Any]) -> float:
    """Hold a stick and release it; returns the time at which it was first held (monotonic [s])."""
    await asyncio.sleep(PAUSE_S)
    begun_s = time.monotonic()
    while time.monotonic() - begun_s < STROKE_S:
        await client.say("publish", topic=topic, msg=message)
        await asyncio.sleep(STICK_PERIOD_S)
    return begun_s


def _changed_s(entries: list[Entry], begun_s: float) -> float:
    """Return the first time at which a goal differed from its value at ``begun_s`` (monotonic [s])."""
    before = next(entry for entry in reversed(entries) if entry.at_s <= begun_s)
    return next(entry.at_s for entry in entries if entry.at_s > begun_s and entry.goal != before.goal)


async def _answers() -> list[list[str]]:
    pool = PlannerPool(ROBOT)
    await pool.start()
    await _asked_s(pool, 1)
    try:
        rows = [["as it is", str(QUESTIONS), *percentiles(await _asked_s(pool), 50, 99, 100)]]
        planning = asyncio.ensure_future(_plan_for_ever(pool))
        rows.append(["a motion is being planned", str(QUESTIONS), *percentiles(await _asked_s(pool), 50, 99, 100)])
        planning.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await planning
    finally:
        await pool.close()
    return rows


async def _asked_s(pool: PlannerPool, times: int = QUESTIONS) -> list[float]:
    positions_rad = {joint.name: 0.0 for joint in ROBOT.movable_joints} | READY
    question = ServoQuestion("arm", TIP, positions_rad, {}, PERIOD_S, TipTwist((0.05, 0.1, 0.02), (0.0, 0.1, 0.0)))
    took_s = []
    for _ in range(times):
        begun_s = time.monotonic()
        answer = await pool.ask(question)
        took_s.append(time.monotonic() - begun_s)
        if not isinstance(answer, ServoAnswer):
            raise TypeError(answer.message)
        await asyncio.sleep(PERIOD_S)
    return took_s


async def _plan_for_ever(pool: PlannerPool) -> None:
    while True:
        await pool.ask(SEARCHED)


async def _wild() -> list[list[str]]:
    """Send random setpoints, and measure the servo loop's output at every tick."""
    with _emulator() as (emulator, _):
        arm = Arm(ArmConfig(ROBOT, SerialConfig(CALIBRATION, emulator.port)), lambda _state: None)
        await arm.start(START_TIMEOUT_S)
        told = await _steered_wildly(arm)
        await arm.close()
    bounds = JointBounds.of(ROBOT, JOINTS)
    velocity = np.array([each.velocity_rad_s for each in told])
    at_s = np.array([each.at_s for each in told])
    acceleration = np.diff(velocity, axis=0) / np.diff(at_s)[:, np.newaxis]
    jerk = np.diff(acceleration, axis=0) / (0.5 * (at_s[2:] - at_s[:-2]))[:, np.newaxis]
    shares = [
        np.abs(velocity).max(axis=0) / bounds.max_velocity,
        np.abs(acceleration).max(axis=0) / bounds.max_acceleration,
        np.abs(jerk).max(axis=0) * TIME_TO_FULL_ACCELERATION_S / bounds.max_acceleration,
    ]
    return [[name, *(f"{share[joint]:.2f}" for share in shares)] for joint, name in enumerate(JOINTS)]


async def _steered_wildly(arm: Arm) -> list[Commanded]:
    chance = np.random.default_rng(0)
    bounds = JointBounds.of(ROBOT, JOINTS)
    stream = arm.stream(JOINTS)
    told: list[Commanded] = []
    until_s = time.monotonic() + WILD_S
    for step in itertools.count():
        if time.monotonic() > until_s or stream.ended.done():
            break
        if step % round(WILD_SETPOINT_S / POLL_S) == 0:
            stream.steer(chance.uniform(-0.3, 0.3, len(JOINTS)) * bounds.max_velocity)
        if stream.commanded is not None and (not told or told[-1] is not stream.commanded):
            told.append(stream.commanded)
        await asyncio.sleep(POLL_S)
    return told
