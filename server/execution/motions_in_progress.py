"""Motions that the arm plays for goals at this moment, each of other joints."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from planners.problem import ConcurrencyQuestion
from robot.messages import MotionEnded
from robot.trajectory import Trajectory
from server.execution.motions import Joints


@dataclass(frozen=True)
class MotionInProgress:
    """Motion that the arm plays."""

    trajectory: Trajectory
    ended: asyncio.Future[MotionEnded]

    @property
    def title(self) -> str:
        """Its joints, for people."""
        names = self.trajectory.joint_names
        return f"the motion of {names[0]}" + (f" to {names[-1]}" if len(names) > 1 else "")


class MotionsInProgress:
    """Motions of all goals, by which motions of some joints are planned around motions of others.

    Attributes:
        turn: held by the goal that is being planned, so that the next one knows where its motions end.
    """

    def __init__(self) -> None:
        self._motions: dict[asyncio.Future[MotionEnded], MotionInProgress] = {}
        self._announced: dict[Joints, Mapping[str, float]] = {}
        self.turn = asyncio.Lock()

    def announce(self, joints: Joints, end_rad: Mapping[str, float]) -> None:
        """Tell where motions of some joints that are planned will end [rad]."""
        self._announced[joints] = end_rad

    def withdraw(self, joints: Joints) -> None:
        """Forget what was announced of some joints."""
        self._announced.pop(joints, None)

    def add(self, trajectory: Trajectory, ended: asyncio.Future[MotionEnded]) -> None:
        """Add a motion, until it ends."""
        if not ended.done():
            self._motions[ended] = MotionInProgress(trajectory, ended)
            ended.add_done_callback(lambda _ended: self._motions.pop(ended, None))

    def of(self, joints: Iterable[str]) -> list[MotionInProgress]:
        """Return the motions of any of some joints."""
        wanted = frozenset(joints)
        return [one for one in self._live if wanted & set(one.trajectory.joint_names)]

    def beside(self, joints: Joints) -> list[MotionInProgress]:
        """Return the motions of none but other joints."""
        return [one for one in self._live if not joints & set(one.trajectory.joint_names)]

    def expected_rad(self, held_rad: Mapping[str, float], joints: Joints) -> dict[str, float]:
        """Return where the joints will hold when every motion of others, begun or announced, has ended [rad].

        Args:
            joints: those for which this is asked; they are where they hold now.
        """
        expected_rad = dict(held_rad)
        for one in self.beside(joints):
            end_rad = one.trajectory.positions_rad[-1].tolist()
            expected_rad |= zip(one.trajectory.joint_names, end_rad, strict=True)
        for announced, end_rad_of in self._announced.items():
            if not announced & joints:
                expected_rad |= end_rad_of
        return expected_rad

    @property
    def _live(self) -> list[MotionInProgress]:
        # The callback of an end comes a turn of the event loop later than the end.
        return [one for one in self._motions.values() if not one.ended.done()]


def meeting_question(
    first: Trajectory, second: MotionInProgress, expected_rad: Mapping[str, float]
) -> ConcurrencyQuestion:
    """Return the question to planners if a motion may touch one in progress.

    The whole of the other is asked about, not its rest alone: paused motions can be sent back to where they began.
    """
    moving = {*first.joint_names, *second.trajectory.joint_names}
    others_rad = {name: value for name, value in expected_rad.items() if name not in moving}
    return ConcurrencyQuestion(first, second.trajectory, others_rad)
