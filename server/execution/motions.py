"""Motions that goals ask for: those to plan, one after the other, those planned elsewhere, and how they are spliced.

A motion that replaces the one in progress leaves its path at a splice point ahead, without a stop; a given
trajectory that does not start where the arm is gets a lead-in.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from planners.interface import Planners
from planners.problem import (
    CartesianPlan,
    CartesianProblem,
    Deviation,
    JointPathProblem,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
)
from planners.scene import EMPTY_SCENE, Scene
from robot.description.limits import motion_limits
from robot.description.model import RobotModel
from robot.messages import MotionEnded
from robot.trajectory import PERIOD_S, Trajectory, bridge
from server.errors import RefusedError, refused

# Names of joints.
Joints: TypeAlias = frozenset[str]

# Position of every movable joint [rad].
Positions: TypeAlias = Mapping[str, float]

# A motion to plan.
Problem: TypeAlias = PlanningProblem | CartesianProblem | JointPathProblem


# Makes the problem of a motion for the positions of all joints at its start [rad], or raises RefusedError. It is called
# when the goal's turn comes: the arm may hold elsewhere by then.
MotionStep: TypeAlias = Callable[[Positions], Problem]


@dataclass(frozen=True)
class PlannedMotion:
    """Sequence of motions to plan and then to execute."""

    steps: tuple[MotionStep, ...]  # each makes its problem from the end of the one before
    joints: Joints
    # Makes the scene to plan in for the arm's positions, or raises RefusedError; None for the present scene.
    scene: Callable[[Positions], Scene] | None = None
    attempts: int = 1  # limit of planning attempts, when no motion is found or the scene invalidates it
    delay_s: float = 0.0
    warnings: tuple[str, ...] = ()
    confirm: bool = False  # True for a plan that waits for a user's confirmation
    # True for a plan whose confirmation must name the goal, because its client may not move the arm.
    proposed: bool = False


@dataclass(frozen=True)
class ExternalTrajectory:
    """Trajectory that a client has planned."""

    # Makes it from the position of every joint [rad] and the monotonic time [s] at its start, and the splice point at
    # which it begins, or None at rest; or raises RefusedError.
    trajectory: Callable[[Positions, float, SplicePoint | None], Trajectory]
    joints: Joints
    spliced: bool = True  # False for a motion that can only begin at rest
    # Makes the part before the contact that a failure reports, None where no part is left; None for a trajectory that
    # is played whole.
    cut: Callable[[PlanningFailure], ExternalTrajectory | None] | None = None


Motion: TypeAlias = PlannedMotion | ExternalTrajectory


@dataclass(frozen=True)
class Performed:
    """Motions planned for a goal."""

    start_rad: Mapping[str, float]
    planned: tuple[Trajectory, ...] = ()
    planning_time_s: float = 0.0
    methods: tuple[str, ...] = ()  # of planning, for each motion
    notes: tuple[str, ...] = ()  # sentences on ends that are not at their goals
    scene: Scene = EMPTY_SCENE  # in which the motions were planned
    problem: Problem | None = None  # problem that failed, else the first one
    failure: PlanningFailure | None = None  # reason for which the next motion is missing

    @property
    def duration_s(self) -> float:
        return sum(motion.duration_s for motion in self.planned)

    @property
    def end_rad(self) -> dict[str, float]:
        """Positions of the joints that move, at the end of the last motion [rad]."""
        ends: dict[str, float] = {}
        for motion in self.planned:
            ends |= zip(motion.joint_names, motion.positions_rad[-1].tolist(), strict=True)
        return ends

    @property
    def summary(self) -> str:
        """Sentence for people: duration, methods and planning time; of a motion that a client sent, the first alone."""
        planning = f"planned in {self.planning_time_s * 1e3:.0f} ms" if self.planning_time_s else ""
        found = "; ".join(filter(None, (", ".join(self.methods), planning)))
        return f"a motion of {self.duration_s:.1f} s{f' ({found})' if found else ''}"

    def with_plan(self, problem: Problem, plan: Plan | CartesianPlan) -> Performed:
        note = deviation_note(plan.deviation)
        return replace(
            self,
            planned=(*self.planned, plan.trajectory),
            planning_time_s=self.planning_time_s + plan.planning_time_s,
            methods=(*self.methods, plan.method if isinstance(plan, Plan) else "path of the tip"),
            notes=(*self.notes, note) if note else self.notes,
            problem=self.problem or problem,
        )


NOTHING = Performed({})


async def plan_sequence(
    steps: Sequence[MotionStep], start_rad: Positions, scene: Scene, planners: Planners
) -> Performed:
    """Plan all steps, or those before the first that cannot be planned."""
    planned = Performed(start_rad, scene=scene)
    for number, step in enumerate(steps):
        problem = None
        try:
            problem = step({**start_rad, **planned.end_rad})
            plan = await _plan(problem, scene, planners)
        except RefusedError as error:
            failure = error.failure
            if len(steps) > 1:
                details = {**failure.details, "item": number}
                failure = replace(failure, message=f"items[{number}]: {failure.message}", details=details)
            return replace(planned, failure=failure, problem=problem)
        planned = planned.with_plan(problem, plan)
    return planned


async def _plan(problem: Problem, scene: Scene, planners: Planners) -> Plan | CartesianPlan:
    plan = await planners.ask(problem, scene)
    if isinstance(plan, PlanningFailure):
        raise RefusedError(plan)
    if isinstance(plan, CartesianPlan) and plan.stopped_by is not None:
        raise RefusedError(plan.stopped_by)
    return plan


# Time ahead at which the next motion leaves the present one: planning takes a few milliseconds, some tens on a busy
# machine.
HORIZON_S = 0.16

# A motion whose goal was replaced goes on for at most this time until a given trajectory takes its place: where other
# programs use every core, a check for contacts takes some tenths of a second.
OUTGOING_S = 0.5

# Part of both times that is reserved for the way to the arm process and its next tick.
SENDING_S = 0.03

# The same of the attempts of a given trajectory, which is sent again if the arm has passed the point. The way to the
# arm process takes 0.25 ms on an idle machine. An attempt that fails at a tick costs nothing if the next one is in time
# for the tick after it, as it would have been without the first.
SENDINGS_S = (0.0005, 0.0005, 0.005, SENDING_S)

# A tick is later by at most this, unless other programs use every core [s]; an arm that has passed the point refuses.
TICK_LATE_S = 0.003

# A trajectory comes to the arm later than expected by at most this, mostly: its check takes 3 to 4 ms [s].
ARRIVAL_LATE_S = 0.001

# Rounding of monotonic times and their sums, far below any visible effect [s].
ROUNDING_S = 1e-8

# The arm may have played less of its motion, by at most this, than its latest state shows: states come at 50 Hz [s].
STATE_AGE_S = 0.1

# Points of the motion nearer to an end of the lead are left out: on a piece of 1e-18 s, which rounding makes, the
# accelerations of the cubic are arbitrary [s].
MIN_PIECE_S = 1e-6

# MoveIt's allowed_start_tolerance: backlash and droop of a client's measured start, and the rounding of the arm's
# controller, since the motion was planned.
START_TOLERANCE_RAD = 0.05

# Nearer starts are the same: half a servo tick.
SAME_START_RAD = 0.0008

# Share of the limits that the lead-in uses; it is short, and no client asked for it.
LEAD_IN_SCALING = 0.2


@dataclass(frozen=True)
class SplicePoint:
    """Point at which another motion can replace the present one."""

    lead: Trajectory  # the present motion from a little before now to the point, its time from 0 on
    from_s: float  # time on the present motion at which the lead begins [s]
    leaves_s: float  # monotonic time at which the lead ends [s]

    @property
    def start_rad(self) -> dict[str, float]:
        return dict(zip(self.lead.joint_names, self.lead.positions_rad[0].tolist(), strict=True))

    @property
    def positions_rad(self) -> dict[str, float]:
        return dict(zip(self.lead.joint_names, self.lead.positions_rad[-1].tolist(), strict=True))

    @property
    def velocities_rad_s(self) -> dict[str, float]:
        return dict(zip(self.lead.joint_names, self.lead.velocities_rad_s[-1].tolist(), strict=True))


def start_of(
    joints: Sequence[str], held_rad: Positions, point: SplicePoint | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of joints at a splice point, or at rest where the arm holds."""
    if point is not None:
        return point.lead.sample(point.lead.duration_s)
    still = np.zeros(len(joints))
    return np.array([held_rad[name] for name in joints]), still, still


@dataclass(frozen=True)
class PathTime:
    """Time on the path of a motion at a monotonic time [s], and its rate: 0 where the motion waits or goes back."""

    at_s: float
    path_s: float
    rate: float
    at_tick: bool = False  # True where the arm has a tick at that time

    def at(self, now_s: float) -> float:
        return self.path_s + (now_s - self.at_s) * self.rate

    def earliest_leave_s(self, arrives_s: float) -> float:
        """Return the earliest time at which a trajectory that comes to the arm at some time can leave the path [s].

        Between two ticks the arm does not change its goals: this is just after the last tick before, where that is
        known.
        """
        if not self.at_tick:
            return arrives_s
        since_tick_s = self._since_tick_s(arrives_s)
        return arrives_s - since_tick_s + min(since_tick_s, TICK_LATE_S)

    def clear_of_tick(self, arrives_s: float) -> float:
        """Return a time of arrival, or the next tick's where the arrival might be after it as well as before it [s]."""
        tick_s = self.passes_s(arrives_s)
        return tick_s if self.at_tick and tick_s - arrives_s < ARRIVAL_LATE_S else arrives_s

    def passes_s(self, arrives_s: float) -> float:
        """Return the time at which the arm is past that point: of its next tick, or a period later."""
        return arrives_s + PERIOD_S - (self._since_tick_s(arrives_s) if self.at_tick else 0.0)

    def _since_tick_s(self, time_s: float) -> float:
        # The time of a tick, a sum of others, is rounded, and must not be taken for the end of the period before it.
        return max(math.fmod(time_s - self.at_s + ROUNDING_S, PERIOD_S) - ROUNDING_S, 0.0)


def splice_point_of(motion: Trajectory, path_time: PathTime, now_s: float, horizon_s: float) -> SplicePoint | None:
    """Return the point, a horizon ahead or at its end, at which a motion can be replaced; None if it waits or ends."""
    reached_s = path_time.at(now_s)
    leave_s = min(reached_s + horizon_s * path_time.rate, motion.duration_s)
    from_s = max(reached_s - STATE_AGE_S * max(path_time.rate, 1.0), 0.0)
    if path_time.rate == 0.0 or reached_s > motion.duration_s or leave_s - from_s < MIN_PIECE_S:
        return None
    return SplicePoint(_between(motion, from_s, leave_s), from_s, now_s + horizon_s)


def with_lead_in(motion: Trajectory, held_rad: Mapping[str, float], robot: RobotModel) -> Trajectory:
    """Return a motion with the way to its start from where the arm holds, which must be near, before it."""
    held = np.array([held_rad[name] for name in motion.joint_names])
    away = np.abs(motion.positions_rad[0] - held)
    worst = int(np.argmax(away))
    if away[worst] > START_TOLERANCE_RAD:
        name = motion.joint_names[worst]
        unit, start, held_at = robot.joints[name].unit, float(motion.positions_rad[0, worst]), float(held[worst])
        raise refused(
            MoveItErrorCode.CONTROL_FAILED,
            f"the motion starts with joint {name} at {start:.4f} {unit}, but the arm holds it at {held_at:.4f}"
            f" {unit} (tolerance {START_TOLERANCE_RAD} {unit}): plan it again from here",
            joint=name,
            start_rad=start,
            held_rad=held_at,
            tolerance_rad=START_TOLERANCE_RAD,
        )
    if away[worst] <= SAME_START_RAD:
        return motion
    limits = motion_limits(robot, motion.joint_names, LEAD_IN_SCALING)
    gentle = replace(limits, acceleration=LEAD_IN_SCALING * limits.acceleration)
    still = np.zeros(len(held))
    return bridge(motion.joint_names, (held, still, still), (motion.positions_rad[0], still), gentle, 0.0).then(motion)


def _between(motion: Trajectory, from_s: float, to_s: float) -> Trajectory:
    inside = (motion.time_s > from_s + MIN_PIECE_S) & (motion.time_s < to_s - MIN_PIECE_S)
    first, last = motion.sample(from_s), motion.sample(to_s)
    arrays = (motion.positions_rad, motion.velocities_rad_s, motion.accelerations_rad_s2)
    columns = [np.vstack((first[i], array[inside], last[i])) for i, array in enumerate(arrays)]
    time_s = np.concatenate(([0.0], motion.time_s[inside] - from_s, [to_s - from_s]))
    return Trajectory(motion.joint_names, time_s, *columns)


@dataclass(frozen=True)
class MotionInProgress:
    """Motion that the arm plays."""

    trajectory: Trajectory
    ended: asyncio.Future[MotionEnded]

    @property
    def title(self) -> str:
        names = self.trajectory.joint_names
        return f"the motion of {names[0]}" + (f" to {names[-1]}" if len(names) > 1 else "")


class MotionsInProgress:
    """Motions of all goals, around which the motions of other joints are planned, one goal at a ``turn``."""

    def __init__(self) -> None:
        self._motions: dict[asyncio.Future[MotionEnded], MotionInProgress] = {}
        self._announced: dict[Joints, Mapping[str, float]] = {}
        self.turn = asyncio.Lock()

    def announce(self, joints: Joints, end_rad: Mapping[str, float]) -> None:
        """Note where the planned motions of some joints will end [rad]."""
        self._announced[joints] = end_rad

    def withdraw(self, joints: Joints) -> None:
        self._announced.pop(joints, None)

    def add(self, trajectory: Trajectory, ended: asyncio.Future[MotionEnded]) -> None:
        if not ended.done():
            self._motions[ended] = MotionInProgress(trajectory, ended)
            ended.add_done_callback(lambda _ended: self._motions.pop(ended, None))

    def sharing(self, joints: Joints) -> list[MotionInProgress]:
        """Return the motions that move any of some joints."""
        return [motion for motion in self._live if not joints.isdisjoint(motion.trajectory.joint_names)]

    def beside(self, joints: Joints) -> list[MotionInProgress]:
        """Return the motions of other joints alone."""
        return [motion for motion in self._live if joints.isdisjoint(motion.trajectory.joint_names)]

    def expected_rad(self, held_rad: Mapping[str, float], joints: Joints) -> dict[str, float]:
        """Return the positions [rad] of some joints now, and of others after their motions, begun or announced."""
        expected_rad = dict(held_rad)
        for motion in self.beside(joints):
            end_rad = motion.trajectory.positions_rad[-1].tolist()
            expected_rad |= zip(motion.trajectory.joint_names, end_rad, strict=True)
        for announced, announced_rad in self._announced.items():
            if not announced & joints:
                expected_rad |= announced_rad
        return expected_rad

    @property
    def _live(self) -> list[MotionInProgress]:
        # The callback of an end comes a turn of the event loop later than the end.
        return [motion for motion in self._motions.values() if not motion.ended.done()]


# Smaller deviations are within what a servo arm reaches anyway [m], [rad].
REPORTED_POSITION_M = 0.001
REPORTED_ORIENTATION_RAD = 0.01


def deviation_note(deviation: Deviation) -> str:
    """Describe in words how far the end of a motion is from the goal; empty for a deviation too small to matter."""
    parts = []
    if deviation.position_m > REPORTED_POSITION_M:
        parts.append(f"the position is {1000.0 * deviation.position_m:.1f} mm off")
    if deviation.orientation_rad > REPORTED_ORIENTATION_RAD:
        parts.append(
            f"the orientation is {math.degrees(deviation.orientation_rad):.1f} degrees off, the nearest there is"
        )
    return " and ".join(parts)
