import asyncio
import os
import pty
import signal
from collections.abc import Awaitable, Callable

import pytest

from harness.waiting import until
from server import lifecycle
from server.errors import StartError
from server.lifecycle import RESERVED_S, Part, allowance_s, on_hangup, start_in_order, stop_in_reverse

pytestmark = pytest.mark.stepped_time

TOTAL_S = 2.0


def recorder(taken: list[str], name: str, takes_s: float = 0.0) -> Callable[[], Awaitable[None]]:
    async def end() -> None:
        taken.append(name)
        await asyncio.sleep(takes_s)

    return end


async def test_parts_start_in_order_and_one_that_fails_is_among_those_to_stop() -> None:
    taken: list[str] = []

    async def broken() -> None:
        raise StartError("port in use")

    parts = [Part("a", recorder(taken, "a")), Part("b", broken), Part("c", recorder(taken, "c"))]
    started: list[Part] = []
    with pytest.raises(StartError):
        await start_in_order(parts, started)
    assert taken == ["a"]
    assert started == parts[:2]


async def test_a_background_task_that_fails_is_logged_at_once_and_stops(caplog: pytest.LogCaptureFixture) -> None:
    async def fail() -> None:
        raise RuntimeError("a bug")

    task = lifecycle.BackgroundTask("zenoh", fail)
    await task.start()
    await asyncio.sleep(0.01)
    assert "zenoh failed" in caplog.text
    await task.stop()
    await task.stop()


async def test_parts_stop_in_reverse_also_behind_one_that_hangs_or_fails(caplog: pytest.LogCaptureFixture) -> None:
    taken: list[str] = []

    async def broken() -> None:
        taken.append("zenoh")
        raise ValueError("no such thing")

    steps = [
        Part("clients", stop=recorder(taken, "clients"), deadline_s=1.0),
        Part("goals", stop=recorder(taken, "goals", 60.0), deadline_s=0.02),
        Part("zenoh", stop=broken, deadline_s=1.0),
    ]
    await asyncio.wait_for(stop_in_reverse(steps, TOTAL_S), 1.0)
    assert taken == ["zenoh", "goals", "clients"]
    assert "goals did not end within 0.0 s; going on" in caplog.text
    assert "stopping: zenoh failed" in caplog.text


async def test_a_step_that_does_not_even_let_itself_be_cancelled_holds_nothing_up() -> None:
    taken: list[str] = []
    released = asyncio.Event()

    async def stubborn() -> None:
        while not released.is_set():
            try:
                await released.wait()
            except asyncio.CancelledError:
                taken.append("cancelled")

    hanging = Part("stubborn", stop=stubborn, deadline_s=0.01)
    steps = [Part("next", stop=recorder(taken, "next"), deadline_s=1.0), hanging]
    await asyncio.wait_for(stop_in_reverse(steps, TOTAL_S), 1.0)
    released.set()
    assert taken == ["cancelled", "next"]


async def test_a_hurry_leaves_each_step_little_time() -> None:
    taken: list[str] = []
    hurry = asyncio.Event()
    steps = [Part(name, stop=recorder(taken, name, 60.0), deadline_s=30.0) for name in ("b", "a")]
    loop = asyncio.get_running_loop()
    loop.call_later(0.01, hurry.set)
    await stop_in_reverse(steps, 60.0, hurry, loop.time)
    assert taken == ["a", "b"]
    assert loop.time() == pytest.approx(0.01 + 2 * lifecycle.HURRIED_S)


async def test_a_step_beyond_the_total_leaves_the_others_their_time(caplog: pytest.LogCaptureFixture) -> None:
    taken: list[str] = []
    loop = asyncio.get_running_loop()
    arm = Part("arm", stop=recorder(taken, "arm", 20.0), deadline_s=30.0, beyond_total=True)
    clients = Part("clients", stop=recorder(taken, "clients", 0.8), deadline_s=1.0)
    await stop_in_reverse([clients, arm], TOTAL_S, clock=loop.time)
    assert taken == ["arm", "clients"]
    assert caplog.text == ""


def test_a_step_gets_what_the_total_allows() -> None:
    # Its deadline, what the later steps leave, and its reserve when all is used up.
    for deadline_s, left_s, after, allowed_s in ((0.5, 2.0, 3, 0.5), (1.0, 0.8, 3, 0.5), (1.0, -0.3, 0, RESERVED_S)):
        assert allowance_s(deadline_s, left_s, after) == pytest.approx(allowed_s)


async def test_the_first_signal_ends_and_the_second_hurries() -> None:
    ending, hurry = lifecycle.stop_signals()
    os.kill(os.getpid(), signal.SIGTERM)
    await asyncio.wait_for(ending.wait(), 1.0)
    assert not hurry.is_set()
    os.kill(os.getpid(), signal.SIGINT)
    await asyncio.wait_for(hurry.wait(), 1.0)


async def test_a_start_is_given_up_when_the_end_comes_before_it_is_done() -> None:
    ending = asyncio.Event()
    starting = asyncio.create_task(lifecycle.unless_ended(ending, asyncio.sleep(60.0)))
    await asyncio.sleep(0)
    ending.set()
    assert not await asyncio.wait_for(starting, 1.0)


class Told:
    """Record of the calls that a hangup leads to."""

    def __init__(self, is_terminal: Callable[[int], bool]) -> None:
        self.calls: list[str] = []
        on_hangup(lambda: self.calls.append("reload"), lambda: self.calls.append("end"), is_terminal)

    async def after_hangup(self) -> list[str]:
        signal.raise_signal(signal.SIGHUP)
        await until(lambda: self.calls)
        asyncio.get_running_loop().remove_signal_handler(signal.SIGHUP)
        return self.calls


@pytest.mark.parametrize(("terminal", "gone", "call"), [(0, 0, "reload"), (1, 0, "reload"), (1, 1, "end")])
async def test_a_hangup_ends_a_program_whose_terminal_is_gone_and_has_others_read_their_files_again(
    terminal: int, gone: int, call: str
) -> None:
    ours, theirs = pty.openpty()
    told = Told(lambda _descriptor: bool(terminal) and os.isatty(theirs))
    if gone:
        os.close(ours)
    assert await told.after_hangup() == [call]
    for descriptor in (theirs,) if gone else (ours, theirs):
        os.close(descriptor)
