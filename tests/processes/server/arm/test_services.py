"""An emergency stop beside a flood, and a fault of an arm whose process is killed."""

import asyncio
import json
import os
import re
import signal

from websockets.asyncio.client import connect

from harness.clients import ArmClient, values_of
from harness.server import ServerOnBus
from harness.waiting import until
from tests.server.arm.test_services import begin_to_move


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
