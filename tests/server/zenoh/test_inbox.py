from __future__ import annotations

import asyncio
import threading

from server.zenoh import inbox
from server.zenoh.inbox import Inbox
from tests.helpers.zenoh_network import until


async def test_items_of_other_threads_come_to_the_loop_in_order() -> None:
    taken: list[int] = []
    box = Inbox[int](asyncio.get_running_loop(), taken.append)
    thread = threading.Thread(target=lambda: [box.put(number, 1) for number in range(100)])
    thread.start()
    await until(lambda: len(taken) == 100)
    thread.join()
    assert taken == list(range(100))
    assert box.dropped == 0


async def test_of_too_many_items_the_newest_are_kept() -> None:
    taken: list[int] = []
    box = Inbox[int](asyncio.get_running_loop(), taken.append)
    for number in range(inbox.MAX_WAITING + 5):
        box.put(number, 1)
    await until(lambda: len(taken) >= inbox.MAX_WAITING)
    assert taken == list(range(5, inbox.MAX_WAITING + 5))
    assert box.dropped == 5


async def test_of_too_large_items_the_newest_are_kept() -> None:
    taken: list[int] = []
    box = Inbox[int](asyncio.get_running_loop(), taken.append)
    for number in range(3):
        box.put(number, inbox.MAX_WAITING_BYTES // 2)
    await until(lambda: len(taken) >= 2)
    assert taken == [1, 2]


async def test_a_full_inbox_lets_others_have_their_turn() -> None:
    taken: list[int] = []
    box = Inbox[int](asyncio.get_running_loop(), taken.append)
    for number in range(3 * inbox.ITEMS_AT_A_TIME):
        box.put(number, 1)
    await asyncio.sleep(0)
    assert len(taken) <= inbox.ITEMS_AT_A_TIME


def test_what_comes_after_the_end_of_the_loop_is_lost_quietly() -> None:
    loop = asyncio.new_event_loop()
    box = Inbox[int](loop, lambda _item: None)
    loop.close()
    box.put(1, 1)
