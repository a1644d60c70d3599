"""Errors of the server room.

ServerError
├── GraphError          an operation on a topic that the graph refuses
├── ConfigurationError  a setting that is wrong or contradicts another
└── StartError          a part of the server that cannot start
"""

from __future__ import annotations


class ServerError(Exception):
    """Base of the server's errors; the text is one sentence for the user."""


class GraphError(ServerError):
    """An operation on a topic that the graph refuses.

    Attributes:
        topic: the topic's name.
    """

    def __init__(self, topic: str, message: str) -> None:
        super().__init__(f"topic {topic}: {message}")
        self.topic = topic


class ConfigurationError(ServerError):
    """A setting that is wrong or contradicts another."""


class StartError(ServerError):
    """A part of the server that cannot start."""
