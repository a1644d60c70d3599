"""Nodes of the graph with their roles, the rules of names, and the filters of names that hold for all clients."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from fnmatch import translate


class Role(IntEnum):
    """Rights of a client; each role includes the roles before it.

    VIEW reads, plans and stops; PROPOSE sends goals, which wait for the approval of a client with OPERATE; OPERATE
    moves the arm and changes the scene; ADMIN configures.
    """

    VIEW = 1
    PROPOSE = 2
    OPERATE = 3
    ADMIN = 4


@dataclass(frozen=True)
class Identity:
    """Role of a client, and the name of its token; empty for a client that has shown none."""

    name: str
    role: Role

    @property
    def by_token(self) -> bool:
        return bool(self.name)


# Every client of a server without tokens.
ANYONE = Identity("", Role.ADMIN)


@dataclass(eq=False, repr=False)
class Node:
    """Participant in the graph: a client (``remote``), or a part of the server, whose names no client may take."""

    name: str
    remote: bool = field(default=False, kw_only=True)
    takes_goals_along: bool = field(default=False, kw_only=True)  # True to cancel its goals when it leaves
    identity: Identity | None = field(default=ANYONE, kw_only=True)  # None until a client has authenticated
    address: str = field(default="", kw_only=True)

    @property
    def is_viewer(self) -> bool:
        """True for a client that moves and changes nothing by itself, and for a client without an identity yet."""
        return self.identity is None or self.identity.role < Role.OPERATE

    def __repr__(self) -> str:
        return self.name


def display_name(identity: Identity | None, address: str) -> str:
    """Return the name of a client in logs and in answers to others."""
    return f"{identity.name} ({address})" if identity is not None and identity.by_token else f"client {address}"


@dataclass(frozen=True)
class Rule:
    """Requirements of a service, a topic or an action."""

    role: Role
    # True for names that stop the arm; they are open past filters and control to every client with the role.
    stops: bool = False
    at_once: bool = False  # True for names that go ahead of everything that waits
    # Text in the field ``data`` with which alone a message does so; None for any message.
    at_once_data: str | None = None
    drives: bool = False  # True for names that move or switch the arm, which one client does at a time
    goal: bool = False  # True for names that count against the rate of goals
    # Path of the field in a goal that may say that nothing moves; empty where there is none.
    plan_only: tuple[str, ...] = ()
    plans: bool = False  # True for services whose answer takes a planner; a client's calls that wait for it are limited
    arm: str = ""  # one of several arms whose control is needed; empty for control of all

    @property
    def cancels(self) -> bool:
        """True for names that end goals in their client's turn."""
        return self.stops and not self.at_once


LOOKING = Rule(Role.VIEW)
PLANNING = Rule(Role.VIEW, plans=True)
CANCELLING = Rule(Role.VIEW, stops=True)
STOPPING = Rule(Role.VIEW, stops=True, at_once=True)
STOP_EVENT = Rule(Role.VIEW, stops=True, at_once=True, at_once_data="stop")
WORKING = Rule(Role.OPERATE)
SWITCHING = Rule(Role.OPERATE, drives=True)
GOAL = Rule(Role.OPERATE, drives=True, goal=True)
PLANNING_GOAL = Rule(Role.OPERATE, drives=True, goal=True, plan_only=("planning_options", "plan_only"))
CALLED_GOAL = Rule(Role.PROPOSE, drives=True, goal=True, plan_only=("plan_only",), plans=True)
CONFIGURING = Rule(Role.ADMIN)
COMMISSIONING = Rule(Role.ADMIN, drives=True)


class NameFilter:
    """Patterns of names that clients may use, as rosbridge_server's ``topics_glob``; without any, all names."""

    def __init__(self, setting: str, patterns: Iterable[str] = (), always: Iterable[str] = ()) -> None:
        self._setting = setting
        wanted = [*patterns]
        self._pattern = re.compile("|".join(translate(each) for each in (*wanted, *always))) if wanted else None

    def refusal(self, kind: str, name: str) -> str | None:
        if self._pattern is None or self._pattern.match(name):
            return None
        return f"{kind} {name}: fits no pattern of {self._setting}; add one there to open it"
