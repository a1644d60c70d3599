"""The parts of the server as operations look at them: whatever is not there yet is None."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from robot.messages import ArmHealth, ArmState
from server.gateway.connection import Traffic
from server.operations.goal_tally import GoalTally


class ArmPart(Protocol):
    """The arm process, as `robot.arm.Arm`."""

    state: ArmState
    state_max_age_s: float

    @property
    def pid(self) -> int | None:
        """Process id."""

    @property
    def state_age_s(self) -> float:
        """Time since the last state came [s]."""


class PlannersPart(Protocol):
    """The planner processes, as `planners.pool.PlannerPool`."""

    @property
    def load_failure(self) -> str | None:
        """Why no process can plan; None as long as one may."""

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids."""

    @property
    def loaded_count(self) -> int:
        """How many have loaded the robot."""

    @property
    def idle_count(self) -> int:
        """How many wait for a request."""

    @property
    def waiting_count(self) -> int:
        """How many requests wait for a planner."""


class RecorderPart(Protocol):
    """The recording, as `server.recording.recorder.Recorder`."""

    @property
    def dropped(self) -> int:
        """How many messages are missing."""

    @property
    def queued(self) -> int:
        """How many messages wait for the file."""

    @property
    def ended(self) -> bool:
        """Whether nothing more is recorded."""


class ZenohPart(Protocol):
    """The part in a zenoh network, as `server.zenoh.bridge.Bridge`."""

    @property
    def dropped(self) -> int:
        """How many messages were lost."""


class QueuePart(Protocol):
    """The queue of goals, as `server.goal_queue.GoalQueue`."""

    @property
    def waiting_count(self) -> int:
        """How many goals wait."""

    @property
    def busy(self) -> str:
        """Which goal is worked on; empty when there is none."""


@dataclass
class Parts:
    """What can be told of.

    Attributes:
        traffic: what clients say and hear.
        refused_connections: counts those who were not let in, by why.
        goal_tally: how goals ended.
        queue: goals on their way.
        arm: the arm process.
        arm_health: its latest condition.
        planners: the planner processes.
        recorder: the recording; None also when nothing is recorded.
        zenoh: the part in a zenoh network; None also when there is none.
        started: whether the arm has been taken over, and goals are carried out.
        stopping: whether the server is about to end.
    """

    traffic: Traffic | None = None
    refused_connections: Callable[[], Mapping[str, int]] | None = None
    goal_tally: GoalTally | None = None
    queue: QueuePart | None = None
    arm: ArmPart | None = None
    arm_health: ArmHealth | None = None
    planners: PlannersPart | None = None
    recorder: RecorderPart | None = None
    zenoh: ZenohPart | None = None
    started: bool = False
    stopping: bool = False

    def children(self) -> Mapping[str, int]:
        """Process id of every child that runs, by what it is."""
        pids = {} if self.arm is None else {"arm": self.arm.pid}
        planners = () if self.planners is None else self.planners.pids
        pids |= {f"planner_{number}": pid for number, pid in enumerate(planners, 1)}
        return {name: pid for name, pid in pids.items() if pid is not None}
