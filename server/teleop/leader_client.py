"""Rosbridge client that publishes the joints of a relaxed arm: the newest sample alone."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from websockets.asyncio.client import ClientConnection

from protocol.messages import Stamp
from robot.arm import Arm
from robot.messages import ArmState, Mode
from server.arm.setup import Description, arm_config
from server.config import Settings
from server.execution.monitors import ARM_START_TIMEOUT_S
from server.lifecycle import run_until_signal
from server.rosbridge_clients import PublishedTopic, PublishingClient

SAMPLE_TYPE = "sensor_msgs/JointState"

# A server that takes no sample within this time has left without a word.
TAKEN_TIMEOUT_S = 5.0

# Samples on their way: on a slow network the next ones leave before the first are acknowledged. Beyond this number,
# samples are dropped, so that no old sample queues behind a new one.
IN_FLIGHT = 8


class LeaderClient(PublishingClient):
    """Client that publishes samples of an arm, the newest alone; every few samples wait for the server.

    So a slow network gets fewer samples, and never a queue of old ones.
    """

    def __init__(self, target: PublishedTopic, report: Callable[[str], None]) -> None:
        super().__init__(target, SAMPLE_TYPE, report)
        self._newest: asyncio.Queue[ArmState] = asyncio.Queue(1)
        self._reason = ""

    def take_state(self, state: ArmState) -> None:
        """Take a state as the next sample if a hand can move the arm; report the fault of an arm."""
        before, self._reason = self._reason, str(state.fault or state.reason)
        if self._reason not in ("", before):
            self._report(f"the arm: {self._reason}")
        if state.mode is Mode.RELAXED and state.position_rad is not None:
            if self._newest.full():
                self._newest.get_nowait()
            self._newest.put_nowait(state)

    async def publish(self, connection: ClientConnection) -> None:
        """Publish samples for as long as the connection lasts."""
        taken: Awaitable[float] | None = None
        since_ping = 0
        while True:
            state = await self._newest.get()
            async with asyncio.timeout(TAKEN_TIMEOUT_S):
                if since_ping >= IN_FLIGHT and taken is not None:
                    await taken
                    taken, since_ping = None, 0
                await self.send(connection, sample_message(state))
                self.published += 1
                since_ping += 1
                if taken is None:
                    taken, since_ping = await connection.ping(), 0


def sample_message(state: ArmState) -> dict[str, Any]:
    """Return the sensor_msgs/JointState of a state with readings, stamped with the time of the reading."""
    position, velocity = state.position_rad, state.velocity_rad_s
    return {
        "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
        "name": list(state.joint_names),
        "position": [] if position is None else [round(value, 5) for value in position.tolist()],
        "velocity": [] if velocity is None else [round(value, 4) for value in velocity.tolist()],
    }


async def publish_leader(target: PublishedTopic, settings: Settings, report: Callable[[str], None]) -> bool:
    """Publish the joints of a relaxed arm until a signal ends it; return False if the arm cannot be read.

    Raises ConfigurationError for settings of the arm that cannot be used.
    """
    client = LeaderClient(target, report)
    arm = Arm(arm_config(settings, Description.read(settings.arm)), client.take_state)

    async def run() -> None:
        try:
            await arm.start(ARM_START_TIMEOUT_S)
        except TimeoutError:
            report(f"the arm process did not start within {ARM_START_TIMEOUT_S:g} s")
        else:
            await client.run()

    try:
        return await run_until_signal(run())
    finally:
        await arm.close()
