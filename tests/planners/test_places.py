from __future__ import annotations

import asyncio

import pytest

from planners.places import Places


class Guest:
    """Holds a place from when it gets one until it is told to leave."""

    def __init__(self, places: Places) -> None:
        self.inside = False
        self._leaving = asyncio.Event()
        self._task = asyncio.create_task(self._stay(places))

    async def _stay(self, places: Places) -> None:
        async with places.held():
            self.inside = True
            await self._leaving.wait()
        self.inside = False

    async def leave(self) -> None:
        self._leaving.set()
        await self._task
        await turns()

    async def give_up(self) -> None:
        self._task.cancel()
        await asyncio.wait([self._task])
        await turns()


async def turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def guests(places: Places, count: int) -> list[Guest]:
    made = [Guest(places) for _ in range(count)]
    await turns()
    return made


def inside(those: list[Guest]) -> list[bool]:
    return [guest.inside for guest in those]


async def test_who_comes_first_has_the_next_place() -> None:
    places = Places(1)
    those = await guests(places, 3)
    assert inside(those) == [True, False, False]
    assert places.waiting == 2
    await those[0].leave()
    assert inside(those) == [False, True, False]


async def test_a_place_more_lets_one_more_in() -> None:
    places = Places(1)
    those = await guests(places, 3)
    places.add()
    await turns()
    assert inside(those) == [True, True, False]


async def test_a_free_place_that_is_taken_away_is_gone() -> None:
    places = Places(2)
    places.remove()
    assert inside(await guests(places, 2)) == [True, False]


async def test_a_held_place_that_is_taken_away_is_kept_until_it_is_left() -> None:
    places = Places(2)
    those = await guests(places, 4)
    places.remove()
    assert inside(those) == [True, True, False, False]
    await those[0].leave()
    assert inside(those) == [False, True, False, False]
    await those[1].leave()
    assert inside(those) == [False, False, True, False]


async def test_a_place_taken_away_and_added_again_is_there() -> None:
    places = Places(1)
    places.remove()
    places.add()
    assert inside(await guests(places, 2)) == [True, False]


@pytest.mark.parametrize("removed", [False, True])
async def test_who_gives_up_waiting_takes_no_place_along(removed: bool) -> None:
    places = Places(2)
    those = await guests(places, 4)
    if removed:
        places.remove()
    await those[2].give_up()
    assert places.waiting == 1
    await those[0].leave()
    await those[1].leave()
    assert inside(those) == [False, False, False, True]
