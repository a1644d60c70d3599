"""Several arms as one: each has its process, which plays its own joints of a common motion.

All that is sent to several arms leaves in the same turn of the event loop; each begins with the next tick of its own
loop, so that two arms differ by one tick at most, plus the time for which a busy machine delays a process.
"""

from __future__ import annotations

import asyncio
import functools
import itertools
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from robot.arm import Arm, ArmClock, ArmStream, Splice
from robot.calibration import Calibration
from robot.errors import OrderRefused
from robot.faults import Fault
from robot.messages import (
    ArmHealth,
    ArmState,
    BusCounters,
    ChangePace,
    CommandDone,
    Mode,
    MotionEnded,
    MotionProgress,
    Order,
    Outcome,
)
from robot.trajectory import Trajectory, Vector

_GOOD = (Outcome.REACHED, Outcome.GRIPPED)  # good ends of a motion

# Modes of several arms, the mode that most keeps an arm from moving first.
_MODES_BY_WEIGHT = (Mode.FAULT, Mode.DISCONNECTED, Mode.CONNECTED, Mode.MOVING, Mode.RELAXED, Mode.HOLDING)

# Ends of one motion by several arms, the end that explains most about a failure first.
_OUTCOMES_BY_WEIGHT = (
    Outcome.FAULT,
    Outcome.TRACKING_LOST,
    Outcome.BUS_LOST,
    Outcome.PROCESS_LOST,
    Outcome.REFUSED,
    Outcome.NOT_SETTLED,
    Outcome.STOPPED,
    Outcome.UNSTEERED,
    Outcome.GRIPPED,
    Outcome.REACHED,
)


class ArmGroup(ArmClock):
    """Several arms by their names and joints, moved as one; leaders are moved by hand, and enabled by name alone."""

    def __init__(self, arms: Mapping[str, tuple[Arm, tuple[str, ...]]], leaders: Collection[str] = ()) -> None:
        self.leaders = frozenset(leaders)
        self._arms = {name: arm for name, (arm, _) in arms.items()}
        self._arm_of = {joint: name for name, (_, joints) in arms.items() for joint in joints}
        self._groups: dict[frozenset[str], ArmGroup] = {}
        self._joints = {name: joints for name, (_, joints) in arms.items()}
        # Parts of each motion of several arms, by arm.
        self._parts_of: dict[asyncio.Future[MotionEnded], Mapping[str, asyncio.Future[MotionEnded]]] = {}
        self._last_read: dict[str, ArmState] = {}
        self._joined: tuple[tuple[ArmState, ...], ArmState] | None = None
        self._ids = itertools.count(1)
        self.state_max_age_s = max(arm.state_max_age_s for arm in self._arms.values())

    @property
    def last_stop(self) -> int:
        return max(arm.last_stop for arm in self._arms.values())

    rate = 1.0  # time by the arms' clocks per time of the machine

    @property
    def states(self) -> dict[str, ArmState]:
        return {name: arm.state for name, arm in self._arms.items()}

    @property
    def state(self) -> ArmState:
        """Latest states as one, with the last readings of arms not read now; no positions before each has some."""
        present = tuple(arm.state for arm in self._arms.values())
        if self._joined is None or any(a is not b for a, b in zip(self._joined[0], present, strict=True)):
            states = dict(zip(self._arms, present, strict=True))
            self._last_read |= {name: state for name, state in states.items() if state.position_rad is not None}
            readings = [self._last_read.get(name, state) for name, state in states.items()]
            self._joined = present, joined_state(states, readings, self.leaders)
        return self._joined[1]

    @property
    def state_age_s(self) -> float:
        return max(arm.state_age_s for arm in self._arms.values())

    @property
    def clock_s(self) -> float:
        """Clock of the slowest arm [s]."""
        return min(arm.clock_s for arm in self._arms.values())

    @property
    def pids(self) -> tuple[int, ...]:
        return tuple(pid for arm in self._arms.values() for pid in arm.pids)

    def part(self, joint_names: Collection[str]) -> AnyArm:
        names = frozenset(self._arm_of[joint] for joint in joint_names if joint in self._arm_of)
        if len(names) == 1:
            return self._arms[next(iter(names))]
        if not names or names == self._arms.keys():
            return self
        if names not in self._groups:
            self._groups[names] = ArmGroup(
                {name: (arm, self._joints[name]) for name, arm in self._arms.items() if name in names}, self.leaders
            )
        return self._groups[names]

    # Start and end.

    async def launch(self) -> None:
        await asyncio.gather(*(arm.launch() for arm in self._arms.values()))

    async def start(self, timeout_s: float) -> None:
        await asyncio.gather(*(arm.start(timeout_s) for arm in self._arms.values()))

    async def until_started(self, timeout_s: float) -> None:
        await self._each(lambda arm: arm.until_started(timeout_s))

    async def close(self, epoch: int | None = None) -> None:
        await self._each(lambda arm: arm.close(epoch))

    # Motions.

    def execute(
        self,
        trajectory: Trajectory,
        *,
        gripping: bool = False,
        torque_share: float = 1.0,
        continues: Splice | None = None,
        epoch: int | None = None,
    ) -> asyncio.Future[MotionEnded]:
        """Send a trajectory to the arms whose joints it moves; when one ends its part early, the others stop."""
        shares = {
            name: [joint for joint in trajectory.joint_names if self._arm_of.get(joint) == name] for name in self._arms
        }
        begun: dict[str, asyncio.Future[MotionEnded]] = {}
        for name, joints in shares.items():
            if joints:
                begun[name] = self._arms[name].execute(
                    trajectory.of_joints(tuple(joints)),
                    gripping=gripping,
                    torque_share=torque_share,
                    continues=continues and continues._replace(motion=self._part_of(name, continues.motion)),
                    epoch=epoch,
                )
        if len(begun) == 1:
            return next(iter(begun.values()))
        ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
        self._parts_of[ended] = begun
        for part in begun.values():
            part.add_done_callback(functools.partial(self._part_ended, ended))
        return ended

    def _part_of(self, name: str, motion: asyncio.Future[MotionEnded]) -> asyncio.Future[MotionEnded]:
        return self._parts_of.get(motion, {}).get(name, motion)

    def _part_ended(self, ended: asyncio.Future[MotionEnded], part: asyncio.Future[MotionEnded]) -> None:
        parts = self._parts_of.get(ended)
        if parts is None or ended.done():
            return
        if part.result().outcome not in _GOOD:
            self._stop_parts(parts)
        if all(part.done() for part in parts.values()):
            del self._parts_of[ended]
            ends = {name: part.result() for name, part in parts.items()}
            # The worst outcome, with each arm's sentence where they differ.
            outcome = min((end.outcome for end in ends.values()), key=_OUTCOMES_BY_WEIGHT.index)
            sentences = {end.message for end in ends.values()}
            if len(sentences) > 1:
                sentences = {"; ".join(f"{name}: {end.message}" for name, end in ends.items())}
            ended.set_result(MotionEnded(0, outcome, sentences.pop()))

    def _stop_parts(self, parts: Mapping[str, asyncio.Future[MotionEnded]]) -> None:
        for name, part in parts.items():
            if not part.done():
                self._arms[name].stop(part)

    def progress(self, motion: asyncio.Future[MotionEnded]) -> MotionProgress | None:
        """Return the progress of a motion; of several arms, the progress of the last."""
        parts = self._parts_of.get(motion)
        if parts is None:
            return next((found for arm in self._arms.values() if (found := arm.progress(motion))), None)
        moving = [self._arms[name].progress(part) for name, part in parts.items() if not part.done()]
        begun = [progress for progress in moving if progress is not None]
        return min(begun, key=lambda progress: progress.fraction) if begun and len(begun) == len(moving) else None

    def stream(self, joint_names: tuple[str, ...], epoch: int | None = None, *, gripping: bool = False) -> ArmStream:
        """Begin a stream of velocity setpoints; raise OrderRefused for joints of several arms."""
        part = self.part(joint_names)
        if isinstance(part, ArmGroup):
            raise OrderRefused(f"a stream moves one arm, not {', '.join(part.states)}")
        return part.stream(joint_names, epoch, gripping=gripping)

    async def end_streams(self, timeout_s: float) -> bool:
        return all(await self._each(lambda arm: arm.end_streams(timeout_s)))

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        """Brake one motion in progress along its path, by every arm that takes part in it; all of them for None."""
        parts = None if motion is None else self._parts_of.get(motion)
        if parts is not None:
            self._stop_parts(parts)
            return
        for arm in self._arms.values():
            arm.stop(motion)

    def brake(self) -> None:
        for arm in self._arms.values():
            arm.brake()

    def change_pace(self, change: ChangePace) -> None:
        for arm in self._arms.values():
            arm.change_pace(change)

    async def rest(self, timeout_s: float) -> bool:
        return all(await self._each(lambda arm: arm.rest(timeout_s)))

    def order(
        self, order: Order, calibration: Calibration | None = None, epoch: int | None = None
    ) -> asyncio.Future[CommandDone]:
        """Send an order to every arm before returning; the answer joins the answers of all."""
        asked = self._arms.keys() - (self.leaders if order is Order.ENABLE else frozenset())
        answers = {name: arm.order(order, calibration, epoch) for name, arm in self._arms.items() if name in asked}
        answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()

        def join(_answer: asyncio.Future[CommandDone]) -> None:
            if not answered.done() and all(answer.done() for answer in answers.values()):
                results = {name: answer.result() for name, answer in answers.items()}
                message = "; ".join(f"{name}: {result.message}" for name, result in results.items())
                done = all(result.done for result in results.values())
                answered.set_result(CommandDone(0, done=done, message=message))

        for answer in answers.values():
            answer.add_done_callback(join)
        return answered

    async def _each(self, act: Callable[[Arm], Coroutine[Any, Any, Any]]) -> Sequence[Any]:
        return await asyncio.gather(*(act(arm) for arm in self._arms.values()))


# Arm that is moved.
AnyArm: TypeAlias = Arm | ArmGroup


def states_of(arm: AnyArm) -> dict[str, ArmState]:
    """Return the latest state of each arm by its name, which is empty for a lone arm."""
    return arm.states if isinstance(arm, ArmGroup) else {arm.name: arm.state}


def moves(arm: AnyArm) -> bool:
    return any(state.mode is Mode.MOVING for state in states_of(arm).values())


def joined_state(
    states: Mapping[str, ArmState], readings: Sequence[ArmState] | None = None, leaders: Collection[str] = ()
) -> ArmState:
    """Return the states of several arms as one state; its mode is the mode that most keeps an arm from moving.

    Positions are from the readings, a state for each arm; while one has none there are none. Without readings they are
    from the states that have some. Leaders are moved by hand: while relaxed, they keep no other arm from moving.
    """
    present = list(states.values())
    known = [state for state in present if state.position_rad is not None] if readings is None else readings
    # Joints of an arm that does not move are held, or stay, where they are read.
    any_holds = any(state.goal_rad is not None for state in known)
    moving = [state for state in present if state.motions]
    leading = max(moving, key=lambda state: max(each.remaining_s for each in state.motions), default=present[0])
    modes = [state.mode for name, state in states.items() if name not in leaders or state.mode is not Mode.RELAXED]
    # The latest by the arms' clocks: the machine's clock may be set, and a lost arm's clock stands still.
    connected = [state for state in present if state.mode is not Mode.DISCONNECTED]
    latest = max(connected or present, key=lambda state: state.clock_s)
    return ArmState(
        stamp_s=latest.stamp_s,
        mode=min(modes or [Mode.RELAXED], key=_MODES_BY_WEIGHT.index),
        joint_names=tuple(name for state in known for name in state.joint_names),
        reason=_joined_reason(states),
        fault=next((_named(name, state.fault) for name, state in states.items() if state.fault is not None), None),
        position_rad=_joined(known, lambda state: state.position_rad),
        velocity_rad_s=_joined(known, lambda state: state.velocity_rad_s),
        age_s=_joined(
            known, lambda state: None if state.age_s is None else state.age_s + (latest.clock_s - state.clock_s)
        ),
        load=_joined(known, lambda state: state.load),
        current_a=_joined(known, lambda state: state.current_a),
        goal_rad=_joined(known, _held_rad) if any_holds else None,
        motions=tuple(motion for state in present for motion in state.motions),
        pace=replace(leading.pace, speed_limit=min(state.pace.speed_limit for state in present)),
        lateness_s=tuple(late_s for state in present for late_s in state.lateness_s),
        clock_s=min(state.clock_s for state in present),
        torque_enabled=all(state.torque_enabled for state in present),
    )


def joined_health(reports: Mapping[str, ArmHealth]) -> ArmHealth:
    """Return the health of several arms as one; the figures of the loops are the worst ones."""
    all_of = list(reports.values())
    limits_rad = [each.limits_rad for each in all_of if each.limits_rad is not None]
    buses = [each.bus for each in all_of if each.bus is not None]
    return ArmHealth(
        monotonic_s=min(each.monotonic_s for each in all_of),
        mode=min((each.mode for each in all_of), key=_MODES_BY_WEIGHT.index),
        port=", ".join(dict.fromkeys(each.port for each in all_of)),
        joints=tuple(joint for each in all_of for joint in each.joints),
        bus=BusCounters(*map(sum, zip(*(vars(bus).values() for bus in buses), strict=True))) if buses else None,
        lateness_s=_greatest([each.lateness_s for each in all_of]),
        round_trip_s=_greatest([each.round_trip_s for each in all_of]),
        real_time=all(each.real_time for each in all_of),
        real_time_factor=min(each.real_time_factor for each in all_of),
        rate=min(each.rate for each in all_of),
        memory_locked=all(each.memory_locked for each in all_of),
        limits_rad=np.concatenate(limits_rad) if len(limits_rad) == len(all_of) else None,
        fault=next((_named(name, each.fault) for name, each in reports.items() if each.fault is not None), None),
        reason="; ".join(f"{name}: {each.reason}" for name, each in reports.items() if each.reason),
    )


def _joined_reason(states: Mapping[str, ArmState]) -> str:
    """Return the reasons of the arms; where the arms' modes differ, also each arm that is relaxed."""
    differ = len({state.mode for state in states.values()}) > 1
    relaxed = {name: Mode.RELAXED.value * (differ and state.mode is Mode.RELAXED) for name, state in states.items()}
    reasons = {name: state.reason or relaxed[name] for name, state in states.items()}
    return "; ".join(f"{name}: {reason}" for name, reason in reasons.items() if reason)


def _held_rad(state: ArmState) -> Vector | None:
    return state.position_rad if state.goal_rad is None else state.goal_rad


def _joined(states: Sequence[ArmState], array_of: Callable[[ArmState], Vector | None]) -> Vector | None:
    arrays = [array for state in states if (array := array_of(state)) is not None]
    return np.concatenate(arrays) if arrays and len(arrays) == len(states) else None


def _named(name: str, fault: Fault | None) -> Fault | None:
    return None if fault is None else replace(fault, message=f"{name}: {fault.message}")


def _greatest(figures: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    p50, p99, greatest = (max(values) for values in zip(*figures, strict=True))
    return p50, p99, greatest
