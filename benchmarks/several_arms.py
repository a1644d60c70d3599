"""Cost of several arms in one server: at rest, while one plans beside the motion of another, and twenty in a row."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil

from harness.clients import ArmClient, arm_client, values_of
from harness.figures import percentiles, print_table
from harness.server import FAST, ROOT, RunningServer

SECONDS = 15.0
SETTLE_S = 4.0
PLANS = 40
ROW, CLIENTS = 20, 5

IDEAL = 'urdf = "{root}/robot/arms/so101/so101.urdf"\nsrdf = "{root}/robot/arms/so101/so101.srdf"\n'


def run() -> None:
    """Measure all three."""
    alone, pair = _at_rest(("left",)), _at_rest(("left", "right"))
    print_table(
        "Processor time at rest, of one core [%]: server, arm processes and planners, one client of /joint_states",
        ["one arm", "two arms", "ratio"],
        [[f"{alone:.1f}", f"{pair:.1f}", f"{pair / alone:.2f}"]],
    )
    still_s, beside_s = asyncio.run(_planning())
    p50 = float(np.percentile(beside_s, 50) / np.percentile(still_s, 50))
    print_table(
        "A plan for one arm, as its client waits for it [ms]",
        ["the other arm", "plans", "p50", "p99"],
        [
            ["rests", str(len(still_s)), *percentiles(still_s, 50, 99)],
            ["moves", str(len(beside_s)), *percentiles(beside_s, 50, 99)],
            ["ratio of p50", "", f"{p50:.2f}", ""],
        ],
    )
    percent, rate = _row()
    print_table(
        f"{ROW} ideal arms, {CLIENTS} clients of /joint_states",
        ["processor time of one core, all processes [%]", "messages a second to each client"],
        [[f"{percent:.0f}", f"{rate:.1f}"]],
    )


@contextlib.contextmanager
def _serving(sections: dict[str, str], settings: dict[str, str] | None = None) -> Iterator[RunningServer]:
    """Serve arms, each with the settings of its section."""
    with tempfile.TemporaryDirectory(prefix="armbridge") as folder:
        config = Path(folder) / "arms.toml"
        config.write_text("".join(f"[arms.{name}]\n{text}\n" for name, text in sections.items()))
        with RunningServer(f"--port 0 --config {config}", settings or {}) as server:
            yield server


def _place(number: int) -> str:
    return f"base_xyz_m = [{number // 5}.0, {number % 5}.0, 0.0]\n"


def _processor_s(server: RunningServer) -> float:
    """Return the processor time that a server and all its processes have used [s]."""
    process = psutil.Process(server.process.pid)
    times = [each.cpu_times() for each in (process, *process.children(recursive=True))]
    return sum(each.user + each.system for each in times)


async def _watched(server: RunningServer, clients: int) -> tuple[float, float]:
    """Return the share of a core that is used while clients watch [%], and the messages a second to each [1/s]."""
    async with contextlib.AsyncExitStack() as stack:
        watching = [await stack.enter_async_context(arm_client(server.url)) for _ in range(clients)]
        for client in watching:
            await client.say("subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        await asyncio.sleep(SETTLE_S)
        before_s, began_s = _processor_s(server), time.monotonic()
        counts = [len(client.topics["/joint_states"]) for client in watching]
        await asyncio.sleep(SECONDS)
        passed_s = time.monotonic() - began_s
        heard = [len(client.topics["/joint_states"]) - count for client, count in zip(watching, counts, strict=True)]
        return 100.0 * (_processor_s(server) - before_s) / passed_s, float(np.mean(heard)) / passed_s


def _at_rest(names: tuple[str, ...]) -> float:
    with _serving({name: _place(number) for number, name in enumerate(names)}) as server:
        return asyncio.run(_watched(server, 1))[0]


def _row() -> tuple[float, float]:
    sections = {f"a{number:02}": _place(number) + IDEAL.format(root=ROOT) for number in range(ROW)}
    with _serving(sections) as server:
        return asyncio.run(_watched(server, CLIENTS))


async def _planning() -> tuple[list[float], list[float]]:
    """Return the times of plans for the right arm, while the left one rests and while it moves [s]."""
    places = {"left": "base_xyz_m = [0.0, 0.4, 0.0]\n", "right": "base_xyz_m = [0.0, -0.4, 0.0]\n"}
    with _serving(places, FAST) as server:
        async with arm_client(server.url) as client:
            await client.say("subscribe", topic="/left/arm/state", type="diagnostic_msgs/DiagnosticStatus")
            still_s = [await _plan(client, number) for number in range(PLANS)]
            await client.goal("/arm/speed_factor", "std_msgs/Float64", {"data": 0.05})
            goal = {"name": ["shoulder_pan", "elbow_flex"], "position": [1.2, 0.5]}
            await client.goal("/left/moveit_goal_joints", "sensor_msgs/JointState", goal)
            await client.until("/left/arm/state", lambda states: values_of(states[-1])["mode"] == "moving")
            beside_s = [await _plan(client, number) for number in range(PLANS)]
            await client.call("/arm/stop")
            return still_s, beside_s


async def _plan(client: ArmClient, number: int) -> float:
    began_s = time.monotonic()
    joints = {"name": ["shoulder_pan", "elbow_flex"], "position": [0.8 * (-1) ** number, 0.3]}
    answer = await client.call("/right/moveit_goal", joints=joints, plan_only=True)
    if not answer["success"]:
        raise RuntimeError(answer["message"])
    return time.monotonic() - began_s


if __name__ == "__main__":
    run()
