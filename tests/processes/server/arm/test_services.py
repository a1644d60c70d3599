"""An arm that starts relaxed, ends relaxed, and whose process is killed."""

import asyncio
import json
import os
import re
import signal
from pathlib import Path

from websockets.asyncio.client import connect

from harness.clients import ArmClient, arm_client, values_of
from harness.server import ServerOnBus, read_write_log, server_on_bus
from harness.waiting import until
from tests.server.arm.test_services import begin_to_move
from tests.server.conftest import FAST


async def test_an_emergency_stop_gets_through_a_flood(client: ArmClient, served: ServerOnBus) -> None:
    await begin_to_move(client)
    flood_type = "trajectory_msgs/JointTrajectory"
    message = {"points": [{"positions": [0.1] * 6} for _ in range(200)]}
    frame = json.dumps({"op": "publish", "topic": "/flood", "type": flood_type, "msg": message})
    await client.say("advertise", topic="/flood", type=flood_type)
    flooding = asyncio.Event()

    async def flood() -> None:
        websocket = await connect(served.server.url)
        try:
            while True:
                await websocket.send(frame)
                flooding.set()
        finally:
            websocket.transport.abort()

    floods = [asyncio.create_task(flood()) for _ in range(3)]
    await until(flooding.is_set)
    stopped = await client.call("/arm/emergency_stop")
    for task in floods:
        task.cancel()
    await asyncio.gather(*floods, return_exceptions=True)
    assert stopped["success"]


async def test_a_fault_outlives_the_arm_process(client: ArmClient, served: ServerOnBus) -> None:
    await client.call("/arm/emergency_stop")
    pid = next(int(found[1]) for line in served.server.lines if (found := re.search(r"\(process (\d+), 100 Hz", line)))
    os.kill(pid, signal.SIGKILL)
    await client.until_mode("disconnected")
    assert values_of(await client.until_mode("fault"))["fault"] == "emergency_stop"


async def test_an_arm_that_is_not_to_be_enabled_starts_relaxed_and_ends_relaxed(tmp_path: Path) -> None:
    log = tmp_path / "writes.jsonl"
    with server_on_bus(EMULATOR__WRITE_LOG=str(log), ARM__START_ENABLED="false", ARM__ON_EXIT="relax", **FAST) as made:
        async with arm_client(made.server.url) as client:
            await client.until_mode("relaxed")
            assert (await client.call("/arm/enable"))["success"]
            await begin_to_move(client)
        assert made.server.end(signal.SIGTERM)[0] == 0
        assert set(read_write_log(log)[-1]["torque"].values()) == {0}
