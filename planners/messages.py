"""Messages between the server and a planner process.

The server sends :class:`LoadRobot` once. Then, in any number: a scene as :class:`NewScene` followed by
:class:`MoreObjects` until it is whole (:mod:`planners.scene_transfer`), and requests, the next after the answer to the
last. Each request gets one :class:`Answered`, and a problem that takes longer than most :class:`StillSearching` before.
"""

from __future__ import annotations

from dataclasses import dataclass

from planners.problem import Answer, Request
from planners.scene import Scene, SceneObject
from robot.description.model import RobotModel


@dataclass(frozen=True)
class LoadRobot:
    """First message to a worker: the arm to plan for, and the memory that the worker may use for data [bytes]."""

    robot: RobotModel
    memory_limit_bytes: int


@dataclass(frozen=True)
class Loaded:
    """A worker, or a host of planners that has workers of these process ids, is ready for requests."""

    pids: tuple[int, ...] = ()


@dataclass(frozen=True)
class LoadFailed:
    """The worker cannot plan for this robot."""

    reason: str


@dataclass(frozen=True)
class NewScene:
    """The scene of the requests that follow, without its objects."""

    scene: Scene


@dataclass(frozen=True)
class MoreObjects:
    """Further objects of the scene, in its order: large scenes come in parts that are quick to pack."""

    objects: tuple[SceneObject, ...]


@dataclass(frozen=True)
class Ask:
    """One request; the number comes back with the answer."""

    number: int
    request: Request


@dataclass(frozen=True)
class Cancel:
    """Cancellation of a request; if it is still worked on, it is answered PREEMPTED at once."""

    number: int


@dataclass(frozen=True)
class StillSearching:
    """A planning problem exceeds the typical planning time; sent again each time that its own has doubled."""

    number: int
    spent_s: float  # allowed time that is spent on it [s]


@dataclass(frozen=True)
class Answered:
    """The answer to a request; ``ending`` if the worker ends now, so that a fresh one must take its place."""

    number: int
    answer: Answer
    ending: bool = False
