"""A motion that takes the place of another one without a stop: when it may, and how."""

from __future__ import annotations

from collections.abc import Iterable, MutableSequence

from robot.control import acceptance
from robot.control.motion import Motion
from robot.control.streaming import Streaming
from robot.limits import JointBounds
from robot.messages import Execute, MotionEnded, Outcome
from robot.trajectory import Vector


def refusal(
    motions: Iterable[Motion | Streaming],
    command: Execute,
    names: tuple[str, ...],
    bounds: JointBounds,
    goal_rad: Vector,
) -> str:
    """Why a motion may not take the place of the one that it names, or an empty text.

    Args:
        motions: those in progress.
        command: what is asked for; it continues another motion.
        names: the arm's joints, order of the arrays.
        bounds: limits of the joints.
        goal_rad: the goals given last, shape (joints,) [rad].
    """
    former, continues = _former(motions, command), command.continues
    if former is None or continues is None:
        return "the motion whose place it should take is not in progress"
    if command.trajectory.joint_names != former.joint_names or command.gripping or former.gripping:
        return f"motion {former.motion_id} is one of other joints, or a grip: none can take its place"
    begins_rad = goal_rad.copy()
    begins_rad[former.columns] = former.playback.trajectory.sample(continues.from_s)[0]
    reason = acceptance.refusal(command.trajectory, names, bounds, begins_rad)
    if reason or former.playback.leads_into(command.trajectory, continues.from_s):
        return reason
    return f"motion {former.motion_id} is no longer where another could take its place"


def succeed(motions: MutableSequence[Motion | Streaming], motion: Motion) -> MotionEnded | None:
    """Let a motion that is not refused take the place of the one that it names; returns that one's end.

    Args:
        motions: those in progress; the former is taken out of them.
        motion: the new one; it goes on where the former is.
    """
    former, continues = _former(motions, motion.command), motion.command.continues
    if former is None or continues is None:
        return None
    motion.playback.go_on_from(former.playback, continues.from_s)
    motions.remove(former)
    return former.ended(Outcome.STOPPED, f"motion {motion.motion_id} takes its place")


def _former(motions: Iterable[Motion | Streaming], command: Execute) -> Motion | None:
    number = None if command.continues is None else command.continues.motion_id
    found = (one for one in motions if isinstance(one, Motion) and one.motion_id == number)
    return next(found, None)
