"""Streams of messages that a stop ends, in stepped time."""

import asyncio
from typing import cast

import pytest

from robot.stop_epochs import STOP_EPOCHS
from server.arrival import arrived_in
from server.errors import RefusedError
from server.execution.streams import STREAM_PAUSE_S, MessageStream, Silence
from tests.helpers.clock import SteppedLoop

pytestmark = pytest.mark.stepped_time


async def test_a_silence_is_over_after_its_time_and_no_sooner_and_a_standstill_is_none() -> None:
    silence = Silence(1.0)
    assert silence.take_message()
    for pause_s, over in ((0.9, False), (0.9, False), (1.1, True), (0.9, False)):
        await asyncio.sleep(pause_s)
        assert silence.take_message() is over
    cast("SteppedLoop", asyncio.get_running_loop()).advance(100.0)
    await asyncio.sleep(0.7)
    assert not silence.take_message()


async def test_a_message_from_before_a_stop_does_not_begin_a_stream_again() -> None:
    stream, before = MessageStream("/t"), STOP_EPOCHS.present
    last_stop = STOP_EPOCHS.begin()
    with arrived_in(before), pytest.raises(RefusedError, match="publish nothing on /t for 0"):
        stream.check(last_stop)
    with pytest.raises(RefusedError):
        stream.check(last_stop)
    await asyncio.sleep(1.1 * STREAM_PAUSE_S)
    stream.check(last_stop)
