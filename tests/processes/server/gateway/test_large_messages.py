"""Large messages over real sockets, in real time."""

import asyncio

import pytest

from harness.waiting import until
from protocol.limits import Limits
from server.gateway import connection
from tests.server.gateway.test_large_messages import TALKER, numbers, world_with


async def test_pictures_pass_to_four_readers_without_loss() -> None:
    count = 90
    async with world_with() as world:
        readers = [await world.reader() for _ in range(4)]
        reading = [asyncio.create_task(numbers(reader, count)) for reader in readers]
        for number in range(count):
            world.graph.publish(TALKER, "/t", {"data": f"{number} {'x' * 1_000_000}"})
            await asyncio.sleep(1 / 30)
        assert await asyncio.gather(*reading) == [list(range(count))] * 4


async def test_a_slow_reader_of_one_large_message_keeps_the_messages_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    # Ten times a pause between two pieces: on a busy machine the client itself stands still for a second.
    monkeypatch.setattr(connection, "UNREAD_TIMEOUT_S", 3.0)
    async with world_with(Limits(max_topic_delay_s=3.0)) as world:
        reader = await world.deaf()
        world.publish(1, 30_000_000)
        await until(lambda: world.listener.traffic.counts().sent_messages > 0)
        world.publish(3, 1000)
        # Longer than a message may wait with a client that stands still, a piece at a time.
        receiving = asyncio.create_task(numbers(reader, 4))
        for _ in range(12):
            await asyncio.sleep(0.3)
            reader.transport.resume_reading()
            await asyncio.sleep(0.001)
            reader.transport.pause_reading()
        reader.transport.resume_reading()
        assert await receiving == [0, 0, 1, 2]
