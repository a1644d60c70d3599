"""Levels of loggers that are changed while the server runs: in the server and in every child, now or later."""

from __future__ import annotations

import weakref
from typing import Protocol

from robot import logs
from robot.logs import LoggerLevel

# Loggers whose levels can be changed; there are some thirty.
MAX_CHANGED_LOGGERS = 100


class Follower(Protocol):
    """A child, which applies what it is sent."""

    def send(self, message: object) -> None:
        """Send it a message."""


_followers: weakref.WeakSet[Follower] = weakref.WeakSet()
_changed: dict[str, LoggerLevel] = {}


def change(level: LoggerLevel) -> bool:
    """Change a logger's level.

    Returns:
        False when so many other loggers have been changed that no further one is.
    """
    if level.name not in _changed and len(_changed) >= MAX_CHANGED_LOGGERS:
        return False
    _changed[level.name] = level
    logs.apply(level)
    for follower in list(_followers):
        follower.send(level)
    return True


def follow(child: Follower) -> None:
    """Have a child follow, as long as somebody keeps it; it is told what has been changed already."""
    _followers.add(child)
    for level in _changed.values():
        child.send(level)
