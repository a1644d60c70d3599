from __future__ import annotations

import asyncio

import pytest

from planners.cluster.roster import RETRY_PAUSE_S, Roster


class Cluster:
    """Workers whose answers to being recruited are set by the test."""

    def __init__(self) -> None:
        self.answers: dict[str, str | Exception | None] = {}
        self.asked: list[str] = []
        self.go_on = asyncio.Event()
        self.go_on.set()
        self.roster = Roster(self._recruit)

    async def _recruit(self, worker: str) -> str | None:
        self.asked.append(worker)
        await self.go_on.wait()
        answer = self.answers.get(worker)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def see(self, threads: dict[str, int], now_s: float = 0.0) -> None:
        self.roster.see(threads, now_s)
        for _ in range(5):
            await asyncio.sleep(0)


async def test_who_is_seen_and_ready_is_a_member_with_its_threads() -> None:
    cluster = Cluster()
    await cluster.see({"a": 2, "b": 1})
    assert cluster.roster.members == {"a": 2, "b": 1}


async def test_a_member_is_recruited_once_until_it_was_gone() -> None:
    cluster = Cluster()
    for threads in ({"a": 1}, {"a": 1}, {}, {"a": 1}):
        await cluster.see(threads)
    assert cluster.asked == ["a", "a"]


async def test_who_is_gone_is_no_member() -> None:
    cluster = Cluster()
    await cluster.see({"a": 2, "b": 1})
    await cluster.see({"b": 1})
    assert cluster.roster.members == {"b": 1}


async def test_a_worker_on_its_way_is_not_recruited_twice() -> None:
    cluster = Cluster()
    cluster.go_on.clear()
    await cluster.see({"a": 1})
    await cluster.see({"a": 1})
    assert cluster.asked == ["a"]
    assert cluster.roster.busy
    assert cluster.roster.members == {}


@pytest.mark.parametrize(
    ("answer", "told"),
    [("it is too old", "too old"), (OSError("no route"), "no route"), (TimeoutError(), "TimeoutError")],
)
async def test_who_cannot_plan_is_left_out_told_once_and_tried_again(
    answer: str | Exception, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    cluster = Cluster()
    cluster.answers["a"] = answer
    for now_s in (0.0, RETRY_PAUSE_S - 1.0, RETRY_PAUSE_S):
        await cluster.see({"a": 1}, now_s)
    assert cluster.asked == ["a", "a"]
    assert cluster.roster.members == {}
    assert caplog.text.count(told) == 1
    cluster.answers["a"] = None
    await cluster.see({"a": 1}, 2 * RETRY_PAUSE_S)
    assert cluster.roster.members == {"a": 1}


async def test_a_bug_in_one_worker_leaves_the_others() -> None:
    cluster = Cluster()
    cluster.answers["a"] = ValueError("a bug")
    await cluster.see({"a": 1, "b": 1})
    assert cluster.roster.members == {"b": 1}
    assert not cluster.roster.busy


async def test_closed_it_has_no_members_and_gets_none() -> None:
    cluster = Cluster()
    await cluster.see({"a": 1})
    cluster.go_on.clear()
    await cluster.see({"a": 1, "b": 1})
    await cluster.roster.close()
    cluster.go_on.set()
    await asyncio.sleep(0)
    assert cluster.roster.members == {}
    assert not cluster.roster.busy
