from __future__ import annotations

import gc
import logging

import pytest

from robot import log_levels
from robot.log_levels import MAX_CHANGED_LOGGERS
from robot.logs import LoggerLevel

NAME = "armbridge.test_log_levels"


class Child:
    """Hears what it is sent."""

    def __init__(self) -> None:
        self.heard: list[object] = []

    def send(self, message: object) -> None:
        self.heard.append(message)


@pytest.fixture(autouse=True)
def nothing_is_changed_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_levels, "_changed", {})


def test_a_change_holds_here_and_in_children_from_before_and_after() -> None:
    before, after = Child(), Child()
    log_levels.follow(before)
    changes = [LoggerLevel(NAME, logging.DEBUG), LoggerLevel(NAME, logging.ERROR)]
    for each in changes:
        assert log_levels.change(each)
    log_levels.follow(after)
    assert logging.getLogger(NAME).level == logging.ERROR
    assert (before.heard, after.heard) == (changes, changes[1:])


def test_a_child_that_nobody_keeps_is_forgotten() -> None:
    count = len(log_levels._followers)
    child = Child()
    log_levels.follow(child)
    del child
    gc.collect()
    assert len(log_levels._followers) <= count


def test_not_more_loggers_are_changed_than_there_may_be() -> None:
    changes = [LoggerLevel(f"{NAME}.l{number}", 0) for number in range(MAX_CHANGED_LOGGERS + 1)]
    assert [log_levels.change(each) for each in changes] == [True] * MAX_CHANGED_LOGGERS + [False]
    assert log_levels.change(changes[0])
