"""Goals on the default server while other processes load the cores: no goal may fail and no fault may occur.

``python -m benchmarks.busy_machine [BURNERS_A_CORE ...]`` uses other loads than those of the table.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from harness.clients import FrameClient, frame_client
from harness.figures import print_table
from harness.server import RunningServer

GOALS = 40
BURNERS_A_CORE = (0, 1, 2, 4)

# Each goal moves two joints by a quarter of a radian and more, within a second or two on a quiet machine.
SWING_RAD = 0.3
GOAL_TIMEOUT_S = 120.0

# Server of an ordinary user, which may not raise its priority (CAP_SYS_NICE).
ORDINARY_USER = ("setpriv", "--bounding-set", "-sys_nice", "--inh-caps", "-sys_nice")

SUCCESS = 1


@dataclass
class Run:
    """Events of one run."""

    codes: Counter[int] = field(default_factory=Counter)  # number of results by error code
    faults: Counter[str] = field(default_factory=Counter)  # codes of the faults that the arm reported
    silence_s: float = 0.0  # longest time between two messages of ``/joint_states`` at a client [s]
    slowest_share: float = 1.0  # lowest speed of the simulated arm, as a share of real time


def run(burners_a_core: tuple[int, ...] = BURNERS_A_CORE) -> None:
    """Send goals at every load, with and without real-time priority."""
    rows = []
    for ordinary in (False, True):
        if ordinary and shutil.which(ORDINARY_USER[0]) is None:
            print(f"\nwithout {ORDINARY_USER[0]} there is no row of an ordinary user")
            continue
        for count in burners_a_core:
            with burning(count * (os.cpu_count() or 1)):
                found = asyncio.run(_send_goals(ORDINARY_USER if ordinary else ()))
            rows.append(
                [
                    "ordinary" if ordinary else "real-time",
                    str(count),
                    f"{found.codes[SUCCESS]} of {found.codes.total()}",
                    ", ".join(found.faults) or "none",
                    f"{found.silence_s * 1e3:.0f}",
                    f"{found.slowest_share:.0%}",
                ]
            )
    print_table(
        f"{GOALS} goals on the simulated arm beside burning processes",
        ["priority", "burners a core", "succeeded", "faults", "longest silence of /joint_states [ms]", "slowest speed"],
        rows,
    )


@contextlib.contextmanager
def burning(count: int) -> Iterator[None]:
    """Run processes that only compute, until the block ends."""
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


async def _send_goals(prefix: tuple[str, ...]) -> Run:
    found = Run()
    with RunningServer(prefix=prefix) as server:
        async with frame_client(server.url) as client:
            await client.open_goals()
            await client.subscribe("/joint_states", "sensor_msgs/JointState")
            await client.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")
            await client.until("/joint_states", bool)
            for number in range(GOALS):
                side = SWING_RAD if number % 2 else -SWING_RAD
                goal = {"name": ["shoulder_pan", "wrist_roll"], "position": [side, -side]}
                answer = await client.reach("/moveit_goal_joints", goal, GOAL_TIMEOUT_S)
                found.codes[answer["val"]] += 1
            _look_back(client, found)
    return found


def _look_back(client: FrameClient, found: Run) -> None:
    """Read the faults and the speed from the recorded messages."""
    at_s = [message["_at_s"] for message in client.messages("/joint_states")]
    found.silence_s = max(after - before for before, after in itertools.pairwise(at_s))
    for message in client.messages("/diagnostics"):
        values = {pair["key"]: pair["value"] for pair in message["status"][0]["values"]}
        if "fault" in values:
            found.faults[values["fault"]] += 1
        if "real_time_factor" in values:
            found.slowest_share = min(found.slowest_share, float(values["real_time_factor"]))


if __name__ == "__main__":
    run(tuple(map(int, sys.argv[1:])) or BURNERS_A_CORE)
