"""Errors of the server room.

ServerError
├── GraphError          an operation on a topic, service or action that the graph refuses
├── ServiceError        a service that cannot do what it is asked for
├── ConfigurationError  a setting that is wrong or contradicts another
└── StartError          a part of the server that cannot start
"""

from __future__ import annotations

from typing import Literal


class ServerError(Exception):
    """Base of the server's errors; the text is one sentence for the user."""


class GraphError(ServerError):
    """An operation that the graph refuses.

    Attributes:
        name: the topic, service or action.
    """

    def __init__(self, kind: Literal["topic", "service", "action"], name: str, message: str) -> None:
        super().__init__(f"{kind} {name}: {message}")
        self.name = name


class ServiceError(ServerError):
    """A service that cannot do what it is asked for; its caller gets the text."""


class ConfigurationError(ServerError):
    """A setting that is wrong or contradicts another."""


class StartError(ServerError):
    """A part of the server that cannot start."""
