import asyncio
import threading
from collections.abc import Iterator

import pytest

from harness.waiting import TIMEOUT_S
from protocol.errors import MessageError
from protocol.publication import EncodedMessage, Frame
from server.gateway.turns import MessageThreads


@pytest.fixture
def threads() -> Iterator[MessageThreads]:
    made = MessageThreads()
    yield made
    made.close()


async def test_jobs_end_in_the_event_loop_also_by_failing(
    threads: MessageThreads, caplog: pytest.LogCaptureFixture
) -> None:
    ended = asyncio.get_running_loop().create_future()
    threads.run(
        threading.get_ident,
        lambda thread, cost_s: ended.set_result((thread, cost_s, threading.get_ident())),
        lambda: None,
    )
    thread, cost_s, ended_in = await asyncio.wait_for(ended, TIMEOUT_S)
    assert thread != ended_in == threading.get_ident()
    assert cost_s >= 0
    failed = asyncio.Event()

    def job() -> None:
        raise RuntimeError("broken")

    threads.run(job, lambda _result, _cost_s: None, failed.set)
    await asyncio.wait_for(failed.wait(), TIMEOUT_S)
    assert "broken" in caplog.text


async def test_a_message_is_encoded_once_for_all_who_ask_and_left_out_with_a_log_line_if_it_cannot_be(
    threads: MessageThreads, caplog: pytest.LogCaptureFixture
) -> None:
    encoded, ready = [], asyncio.Semaphore(0)

    def encode() -> EncodedMessage:
        encoded.append(1)
        return EncodedMessage(Frame(b"{}", text=True))

    def fail() -> EncodedMessage:
        raise MessageError("a number", "nothing")

    message, other = EncodedMessage.later(encode, 100), EncodedMessage.later(fail, 100)
    for each in (message, message, message, other):
        threads.encode(each, ready.release)
    async with asyncio.timeout(TIMEOUT_S):
        for _ in range(4):
            await ready.acquire()
    assert encoded == [1]
    assert (message.ready, other.ready, other.frames) == (True, True, ())
    assert "not delivered" in caplog.text
