"""Several arms as one: each has its process, and a motion of the joints of several is played by each for its own.

All that is sent to several arms leaves in the same turn of the event loop; each begins with the next tick of its own
loop, so that two arms differ by one tick at most, and by what a busy machine lets one of their processes wait.
"""

from __future__ import annotations

import asyncio
import functools
import itertools
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from typing import Any

from robot.arm import Arm, wait_on_clock
from robot.arm_interface import ArmInterface, StreamInterface
from robot.calibration import Calibration
from robot.errors import OrderRefused
from robot.joined_states import joined_state
from robot.messages import ArmState, ChangePace, CommandDone, MotionEnded, MotionProgress, Order, Outcome
from robot.trajectory import Trajectory

# Ends of a motion that are as good as it gets.
_GOOD = (Outcome.REACHED, Outcome.GRIPPED)

# Of several ends the one that says most about what went wrong comes first.
_BY_WEIGHT = (
    Outcome.FAULT,
    Outcome.TRACKING_LOST,
    Outcome.BUS_LOST,
    Outcome.PROCESS_LOST,
    Outcome.REFUSED,
    Outcome.NOT_SETTLED,
    Outcome.STOPPED,
    Outcome.GRIPPED,
    Outcome.REACHED,
)


class ArmGroup:
    """Several arms that are moved as one.

    Args:
        arms: each by its name, with its joints.
        leaders: those that are moved by hand: they are enabled by their own name alone.
    """

    def __init__(self, arms: Mapping[str, tuple[Arm, tuple[str, ...]]], leaders: Collection[str] = ()) -> None:
        self._leaders = frozenset(leaders)
        self._arms = {name: arm for name, (arm, _) in arms.items()}
        self._arm_of = {joint: name for name, (_, joints) in arms.items() for joint in joints}
        self._parts: dict[frozenset[str], ArmGroup] = {}
        self._joints = {name: joints for name, (_, joints) in arms.items()}
        # The motion of each arm, by that of all.
        self._together: dict[asyncio.Future[MotionEnded], Mapping[str, asyncio.Future[MotionEnded]]] = {}
        self._last_read: dict[str, ArmState] = {}
        self._joined: tuple[tuple[ArmState, ...], ArmState] | None = None
        self._ids = itertools.count(1)
        self.state_max_age_s = max(arm.state_max_age_s for arm in self._arms.values())

    @property
    def last_stop(self) -> int:
        """Stop epoch of the last stop of all motion of any."""
        return max(arm.last_stop for arm in self._arms.values())

    @property
    def states(self) -> dict[str, ArmState]:
        """Latest state of each, by the name of the arm."""
        return {name: arm.state for name, arm in self._arms.items()}

    @property
    def state(self) -> ArmState:
        """Latest states as one; an arm that is not read at present stays where it was read last.

        Joints have no positions before each arm was read once.
        """
        present = tuple(arm.state for arm in self._arms.values())
        if self._joined is None or any(a is not b for a, b in zip(self._joined[0], present, strict=True)):
            states = dict(zip(self._arms, present, strict=True))
            self._last_read |= {name: state for name, state in states.items() if state.position_rad is not None}
            self._joined = present, joined_state(states, self._last_read, self._leaders)
        return self._joined[1]

    @property
    def state_age_s(self) -> float:
        """Age of the oldest of the latest states [s]."""
        return max(arm.state_age_s for arm in self._arms.values())

    @property
    def clock_s(self) -> float:
        """Clock of the slowest arm [s]."""
        return min(arm.clock_s for arm in self._arms.values())

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of all."""
        return tuple(pid for arm in self._arms.values() for pid in arm.pids)

    def part(self, joint_names: Collection[str]) -> ArmInterface:
        """Return the arm, or the arms together, that have some joints."""
        names = frozenset(self._arm_of[joint] for joint in joint_names if joint in self._arm_of)
        if len(names) == 1:
            return self._arms[next(iter(names))]
        if not names or names == self._arms.keys():
            return self
        if names not in self._parts:
            self._parts[names] = ArmGroup(
                {name: (arm, self._joints[name]) for name, arm in self._arms.items() if name in names}, self._leaders
            )
        return self._parts[names]

    # Start and end.

    async def launch(self) -> None:
        """Start the processes, as :meth:`robot.arm.Arm.launch`."""
        await asyncio.gather(*(arm.launch() for arm in self._arms.values()))

    async def start(self, timeout_s: float) -> None:
        """Configure the processes, and wait for the first state of each, as :meth:`robot.arm.Arm.start`."""
        await asyncio.gather(*(arm.start(timeout_s) for arm in self._arms.values()))

    async def until_started(self, timeout_s: float) -> None:
        """Wait while :meth:`start` is in progress."""
        await self._each(lambda arm: arm.until_started(timeout_s))

    async def close(self) -> None:
        """Bring each arm to its end state and end the processes, as :meth:`robot.arm.Arm.close`."""
        await self._each(lambda arm: arm.close())

    async def wait(self, ends: Collection[asyncio.Future[Any]], timeout_s: float) -> bool:
        """Wait until all of some futures are done, on the clock of the slowest arm."""
        return await wait_on_clock(self, ends, timeout_s)

    # Motions.

    def execute(
        self,
        trajectory: Trajectory,
        *,
        gripping: bool = False,
        torque_share: float = 1.0,
        continues: tuple[asyncio.Future[MotionEnded], float] | None = None,
        epoch: int | None = None,
    ) -> asyncio.Future[MotionEnded]:
        """Send a trajectory to the arms whose joints it moves, as :meth:`robot.arm.Arm.execute`.

        What ends the motion of one early stops those of the others.
        """
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
                    continues=self._continued(name, continues),
                    epoch=epoch,
                )
        if len(begun) == 1:
            return next(iter(begun.values()))
        ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
        self._together[ended] = begun
        for name, motion in begun.items():
            motion.add_done_callback(functools.partial(self._one_ended, ended, name))
        return ended

    def _continued(
        self, name: str, continues: tuple[asyncio.Future[MotionEnded], float] | None
    ) -> tuple[asyncio.Future[MotionEnded], float] | None:
        """Return the part of one arm of a motion to splice into."""
        if continues is None:
            return None
        motion, from_s = continues
        together = self._together.get(motion)
        return (motion if together is None else together.get(name, motion)), from_s

    def _one_ended(self, ended: asyncio.Future[MotionEnded], name: str, motion: asyncio.Future[MotionEnded]) -> None:
        together = self._together.get(ended)
        if together is None or ended.done():
            return
        if motion.result().outcome not in _GOOD:
            for other, one in together.items():
                if other != name and not one.done():
                    self._arms[other].stop(one)
        if all(one.done() for one in together.values()):
            del self._together[ended]
            ended.set_result(_joined_end({each: one.result() for each, one in together.items()}))

    def progress(self, motion: asyncio.Future[MotionEnded]) -> MotionProgress | None:
        """Return the progress of a motion: of several arms that of the last."""
        together = self._together.get(motion)
        if together is None:
            return next((found for arm in self._arms.values() if (found := arm.progress(motion))), None)
        moving = [self._arms[name].progress(one) for name, one in together.items() if not one.done()]
        begun = [one for one in moving if one is not None]
        return min(begun, key=lambda one: one.fraction) if begun and len(begun) == len(moving) else None

    def stream(self, joint_names: tuple[str, ...], epoch: int | None = None) -> StreamInterface:
        """Begin a stream of velocity setpoints to joints of one arm.

        Raises:
            OrderRefused: the joints belong to several arms.
        """
        part = self.part(joint_names)
        if isinstance(part, ArmGroup):
            raise OrderRefused(f"a stream moves one arm, not {', '.join(part.states)}")
        return part.stream(joint_names, epoch)

    async def end_streams(self, timeout_s: float) -> bool:
        """Bring every stream to rest; return True when all have ended within ``timeout_s``."""
        return all(await self._each(lambda arm: arm.end_streams(timeout_s)))

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        """Brake one motion in progress along its path, by every arm that takes part in it; all of them for None."""
        together = None if motion is None else self._together.get(motion)
        if together is None:
            for arm in self._arms.values():
                arm.stop(motion)
            return
        for name, one in together.items():
            if not one.done():
                self._arms[name].stop(one)

    def change_pace(self, change: ChangePace) -> None:
        """Change speed factor, course or speed limit of the motions of all."""
        for arm in self._arms.values():
            arm.change_pace(change)

    async def rest(self, timeout_s: float) -> bool:
        """Wait until every motion in progress has ended; return True when they have within ``timeout_s``."""
        return all(await self._each(lambda arm: arm.rest(timeout_s)))

    def order(
        self, order: Order, calibration: Calibration | None = None, epoch: int | None = None
    ) -> asyncio.Future[CommandDone]:
        """Send an order to every arm before returning; the answer is that of all of them."""
        asked = self._arms.keys() - (self._leaders if order is Order.ENABLE else frozenset())
        answers = {name: arm.order(order, calibration, epoch) for name, arm in self._arms.items() if name in asked}
        answered: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()

        def take(_one: asyncio.Future[CommandDone]) -> None:
            if not answered.done() and all(one.done() for one in answers.values()):
                done = {name: one.result() for name, one in answers.items()}
                said = "; ".join(f"{name}: {one.message}" for name, one in done.items())
                answered.set_result(CommandDone(0, done=all(one.done for one in done.values()), message=said))

        for one in answers.values():
            one.add_done_callback(take)
        return answered

    async def _each(self, act: Callable[[Arm], Coroutine[Any, Any, Any]]) -> Sequence[Any]:
        return await asyncio.gather(*(act(arm) for arm in self._arms.values()))


def _joined_end(ends: Mapping[str, MotionEnded]) -> MotionEnded:
    """Return the one end of a motion of several arms: the worst, with what each says where they differ."""
    outcome = min((end.outcome for end in ends.values()), key=_BY_WEIGHT.index)
    said = {end.message for end in ends.values()}
    message = said.pop() if len(said) == 1 else "; ".join(f"{name}: {end.message}" for name, end in ends.items())
    return MotionEnded(0, outcome, message)
