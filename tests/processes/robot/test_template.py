"""Templates and their copies: real processes that echo what they are sent."""

import asyncio
import logging
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from harness.waiting import TIMEOUT_S, until
from robot.logs import LineHandler, LogLine
from robot.processes import Child, DescriptorReserve, Template
from tests.helpers.resources import no_descriptors_left, runs


class Copy:
    """A copy, and what it has sent."""

    def __init__(self, child: Child) -> None:
        self.child = child

    async def answer(self, message: Any) -> Any:
        """Send a message, and return the answer."""
        heard: list[Any] = []
        self.child._on_message = heard.append
        self.child.send(message)
        await until(lambda: heard)
        return heard[0]

    async def end(self) -> str:
        """Return how it has ended, once it has."""
        await until(lambda: not self.child.running)
        return self.child.ending


class Farm:
    """Makes templates that load from a message, and copies."""

    def __init__(self) -> None:
        self._templates: list[Template] = []
        self._children: list[Child] = []

    def template(self, first: object = "the robot", timeout_s: float = TIMEOUT_S) -> Template:
        reserve = DescriptorReserve()
        reserve.fill()
        self._templates.append(Template("tests.helpers.echo_child", ("template", first), reserve, timeout_s))
        return self._templates[-1]

    async def copy(self, template: Template) -> Copy:
        self._children.append(Child(await template.copy(), print, lambda: None))
        await self._children[-1].connect()
        return Copy(self._children[-1])

    async def close(self) -> None:
        for child in self._children:
            await child.kill()
        for template in self._templates:
            await template.close()
            template._reserve.close()


@pytest.fixture
async def farm(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Farm]:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))
    made = Farm()
    yield made
    await made.close()


async def test_copies_that_are_asked_for_at_once_have_what_is_loaded_and_a_channel_each(farm: Farm) -> None:
    template = farm.template("the robot")
    copies = await asyncio.gather(*(farm.copy(template) for _ in range(3)))
    assert len({each.child.pid for each in copies}) == 3
    for number, each in enumerate(copies):
        assert await each.answer("known") == "the robot"
        assert await each.answer(number) == number


async def test_the_end_of_a_copy_is_reported_and_how_it_ended_and_others_go_on(farm: Farm) -> None:
    template = farm.template()
    first, second, third = [await farm.copy(template) for _ in range(3)]
    assert first.child.ending == "it still runs"
    first.child.send(("exit", 7))
    assert await first.end() == "exit code 7"
    await second.child.kill()
    assert second.child.ending == "SIGKILL"
    assert not any(runs(each.child.pid) for each in (first, second))
    assert await third.answer("there?") == "there?"
    third.child.send("close")
    assert await third.end() == "exit code 0"


async def test_copies_end_with_their_template_and_the_next_is_one_of_a_new_template(farm: Farm) -> None:
    template = farm.template()
    before = await farm.copy(template)
    os.kill(psutil.Process(before.child.pid).ppid(), signal.SIGKILL)
    assert await before.end() == "SIGKILL"
    await until(lambda: not runs(before.child.pid))
    assert await (await farm.copy(template)).answer("known") == "the robot"


async def test_a_template_ends_with_its_server_and_a_copy_is_in_a_session_of_its_own(farm: Farm) -> None:
    template = farm.template()
    made = await farm.copy(template)
    parent = psutil.Process(made.child.pid).ppid()
    await made.answer("ready?")
    assert os.getsid(made.child.pid) == made.child.pid
    waiting = asyncio.gather(template.copy(), template.copy(), return_exceptions=True)
    await template.close()
    await until(lambda: not runs(parent) and not runs(made.child.pid))
    # Nor is there another for what still waits for a copy.
    assert [isinstance(error, OSError) for error in await waiting] == [True, True]


@pytest.mark.parametrize(
    ("first", "timeout_s", "words"), [("hangs", 0.1, "within 0.1 s"), ("ends", TIMEOUT_S, r"ended \(exit code 3\)")]
)
async def test_of_a_template_that_does_not_load_there_is_no_copy(
    farm: Farm, first: str, timeout_s: float, words: str
) -> None:
    template = farm.template(first, timeout_s)
    for _ in range(2):
        with pytest.raises(OSError, match=words):
            await template.copy()


async def test_a_copy_logs_over_its_own_channel(farm: Farm) -> None:
    made = await farm.copy(farm.template())
    lines: list[LogLine] = []
    handler = LineHandler("server", lines.append)
    await made.answer("ready?")
    made.child.send(("log", "armbridge.echo", logging.ERROR, "said"))
    await until(lambda: lines)
    handler.close()
    assert [line.text for line in lines] == ["said"]


async def test_copies_are_made_where_all_other_descriptors_are_used_up(farm: Farm) -> None:
    template = farm.template()
    first = await farm.copy(template)
    with no_descriptors_left():
        second = await farm.copy(template)
    assert await second.answer("there?") == "there?"
    assert await first.answer("there?") == "there?"


async def test_a_copy_for_which_no_descriptor_is_left_costs_no_other(farm: Farm) -> None:
    template = farm.template()
    first = await farm.copy(template)
    template._reserve.close()
    with no_descriptors_left(), pytest.raises(OSError, match="Too many open files"):
        await template.copy()
    assert await first.answer("there?") == "there?"
    assert await (await farm.copy(template)).answer("known") == "the robot"
