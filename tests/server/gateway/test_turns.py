import asyncio
import threading

import pytest

from harness.waiting import TIMEOUT_S
from protocol.errors import MessageError
from protocol.publication import EncodedMessage, Frame
from server.gateway.turns import Threads


class TestThreads:
    """Threads of a gateway."""

    async def test_a_job_ends_in_the_event_loop_with_its_result_and_its_cost(self) -> None:
        threads, ended = Threads(), asyncio.get_running_loop().create_future()
        threads.run(
            threading.get_ident,
            lambda thread, cost_s: ended.set_result((thread, cost_s, threading.get_ident())),
            lambda: None,
        )
        thread, cost_s, ended_in = await asyncio.wait_for(ended, TIMEOUT_S)
        threads.close()
        assert thread != ended_in == threading.get_ident()
        assert cost_s >= 0

    async def test_a_job_that_raises_is_logged_and_tells_that_it_failed(self, caplog: pytest.LogCaptureFixture) -> None:
        threads, failed = Threads(), asyncio.Event()

        def job() -> None:
            raise RuntimeError("broken")

        threads.run(job, lambda _result, _cost_s: None, failed.set)
        await asyncio.wait_for(failed.wait(), TIMEOUT_S)
        threads.close()
        assert "broken" in caplog.text

    async def test_a_message_is_encoded_once_for_all_who_ask(self) -> None:
        threads, encoded, ready = Threads(), [], asyncio.Semaphore(0)

        def encode() -> EncodedMessage:
            encoded.append(1)
            return EncodedMessage(Frame(b"{}", text=True))

        message = EncodedMessage.later(encode, 100)
        for _ in range(3):
            threads.encode(message, ready.release)
        async with asyncio.timeout(TIMEOUT_S):
            for _ in range(3):
                await ready.acquire()
        threads.close()
        assert encoded == [1]
        assert message.ready

    async def test_an_unencodable_message_is_left_out_with_a_log_line(self, caplog: pytest.LogCaptureFixture) -> None:
        threads, ready = Threads(), asyncio.Event()

        def encode() -> EncodedMessage:
            raise MessageError("a number", "nothing")

        message = EncodedMessage.later(encode, 100)
        threads.encode(message, ready.set)
        await asyncio.wait_for(ready.wait(), TIMEOUT_S)
        threads.close()
        assert message.ready
        assert message.frames == ()
        assert "not delivered" in caplog.text
