"""Latency of following: from the leader's reading to the follower's process, while a hand moves the leader."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import numpy as np

from harness.clients import arm_client
from harness.figures import percentiles, print_table
from harness.server import FAST, ROOT, EmulatorControl, RunningServer

SECONDS = 20.0
TIMEOUT_S = 60.0
TICK_MS = 10.0

# A hand that turns the shoulder's pan to and fro, 0.4 rad in each second.
MIDDLE_TICK, SWING_TICKS, PERIOD_S = 2048, 250, 4.0


def run() -> None:
    """Measure two simulated arms in one server."""
    told = asyncio.run(_measure())
    latencies_s, lags_rad = ([each[field] for each in told] for field in ("latency_s", "lag_rad"))
    p50, p99 = (float(each) for each in percentiles(latencies_s, 50, 99))
    print_table(
        "Leader and follower, simulated: from the leader's reading to the velocities in the follower's process [ms]",
        ["samples", "p50", "p99", "p99 and the tick that makes them goals, at most"],
        [[str(len(latencies_s)), f"{p50:.2f}", f"{p99:.2f}", f"{p99 + TICK_MS:.2f}"]],
    )
    p50, p95, most = np.percentile(lags_rad, (50, 95, 100)).tolist()
    print_table(
        "From the follower's goals to the leader, of the joint that is furthest behind [rad]",
        ["p50", "p95", "max"],
        [[f"{p50:.3f}", f"{p95:.3f}", f"{most:.3f}"]],
    )


async def _measure() -> list[dict[str, Any]]:
    control = ROOT / "build" / "leader_control"
    control.parent.mkdir(exist_ok=True)
    settings = {**FAST, "ARMBRIDGE_ARMS__LEADER__EMULATOR__CONTROL": str(control)}
    with RunningServer(f"--port 0 --config {ROOT / 'examples' / 'leader_follower.toml'}", settings) as server:
        async with arm_client(server.url) as client:
            await client.say("subscribe", topic="/teleop/state", type="armbridge_msgs/TeleopState")
            answer = await client.call("/teleop/start", follower="", leader="leader")
            if not answer["success"]:
                raise RuntimeError(answer["message"])
            await client.until("/teleop/state", lambda told: told[-1]["phase"] == "following", TIMEOUT_S)
            client.topics["/teleop/state"].clear()
            hand, began_s = EmulatorControl(control), time.monotonic()
            while (passed_s := time.monotonic() - began_s) < SECONDS:
                at = MIDDLE_TICK + round(SWING_TICKS * math.sin(2.0 * math.pi * passed_s / PERIOD_S))
                await asyncio.to_thread(hand.command, hand={"1": at})
                await asyncio.sleep(0.02)
            told = client.topics["/teleop/state"]
            return [each for each in told if each["phase"] == "following"]


if __name__ == "__main__":
    run()
