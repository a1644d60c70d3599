"""What a server and the tasks that it has run on Dask workers say to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class SceneKey(NamedTuple):
    """A scene, told apart from those of other servers.

    Attributes:
        server: random name of the server's connection.
        version: of the scene, as the server counts.
    """

    server: str
    version: int


@dataclass(frozen=True)
class Missing:
    """The worker lacks what the request needs; once it has been sent, the request can be repeated.

    Attributes:
        worker: its address.
        robot: whether it lacks the robot, and with it the scene; else it lacks the scene only.
    """

    worker: str
    robot: bool
