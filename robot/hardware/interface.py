"""Hardware interface between the controller and an arm's actuators, as in ros2_control.

All values are in SI units and arrays of shape (joints,), in the order of ``joint_names``; prismatic joints are in
metres where names say radians. Ticks, registers and packets are confined to the implementations.

Operations of several transactions are sequences (:data:`Steps`): generators that share the hardware with the 100 Hz
tick. A sequence yields before every transaction, so that none holds up a tick or an emergency stop for longer than one
of them; the number it yields is the time to wait first [s].
"""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from robot.calibration import Calibration
from robot.description.limits import JointBounds
from robot.errors import OrderRefused
from robot.faults import Fault
from robot.messages import BusCounters, JointHealth
from robot.trajectory import Vector

if TYPE_CHECKING:
    from robot.physics.world import World

Result = TypeVar("Result")
Steps: TypeAlias = Generator[float, None, Result]

Flags: TypeAlias = NDArray[np.bool_]

ROUND_TRIPS_KEPT = 100  # round trips of the last second at 100 Hz

CALIBRATION_NOT_KEPT = "a calibration is written into Feetech servos only, and this arm has others"


class StatusFlag(IntFlag):
    """Error flags of an actuator; the values are the bits of register STATUS of Feetech's STS3215."""

    VOLTAGE = 1
    ENCODER = 2
    TEMPERATURE = 4
    CURRENT = 8
    ANGLE = 16
    OVERLOAD = 32


def status_names(status: int) -> list[str]:
    """Return the names of the flags in a status word, lowest first; undocumented bits are left out."""
    return [str(flag.name).lower() for flag in StatusFlag if status & flag]


class Measured(NamedTuple):
    """Latest good reading of every joint, each of shape (joints,); NaN where the hardware does not measure it."""

    position_rad: Vector
    velocity_rad_s: Vector
    load: Vector  # share of full motor duty, signed
    current_a: Vector  # motor current, signed [A]
    voltage_v: Vector  # supply [V]
    temperature_c: Vector  # temperature of the motors [degC]
    status: NDArray[np.int_]  # bits of :class:`StatusFlag`
    age_s: Vector  # age of the readings [s]
    stamp_s: float = 0.0  # wall-clock time of the tick [s since the epoch], one number


class Actuation(NamedTuple):
    """Strength of the actuators as they are set, each of shape (joints,)."""

    stiffness: Vector  # position gain as a share of the factory's; with half of it a joint droops twice as far
    max_torque: Vector  # largest share of full duty
    overload_torque: Vector  # share of full duty that must not last; infinite without such a protection
    overload_time_s: Vector  # time for which it may last [s]
    overload_current_a: Vector  # current that must not last; infinite without such a protection [A]
    stall_current_a: Vector  # current of the stalled motor at full duty [A]
    free_speed_rad_s: Vector  # speed without load at full duty [rad/s]
    # Way between two readings in a row beyond which they are no motion; longer gaps allow for the free speed [rad].
    jump_rad: Vector

    @classmethod
    def unprotected(cls, free_speed_rad_s: Vector, jump_rad: Vector) -> Actuation:
        """Return the strength of actuators that have no settings."""
        ones, never = np.ones(len(jump_rad)), np.full(len(jump_rad), np.inf)
        return cls(ones, ones, never, never, never, ones, free_speed_rad_s, jump_rad)


@dataclass(frozen=True)
class Survey:
    """Result of surveying the actuators, to which nothing was written."""

    bounds: JointBounds  # soft limits, narrowed to the actuators' own limits
    driven: Flags  # True for joints whose torque is on, shape (joints,)
    goal_rad: Vector  # goals of those, NaN for the others, shape (joints,) [rad]
    max_voltage_v: Vector  # highest supply of each; infinite where there is no such limit, shape (joints,) [V]
    actuation: Actuation  # their strength
    reply_latency_s: float  # time that the bus waits for a reply [s]


class HardwareInterface(ABC):
    """Actuators of one arm, from opening to :meth:`close`.

    Every method may raise PortLost when the connection to the actuators is gone, and every sequence (``Steps``) NoReply
    when one of them does not answer. Sequences leave the hardware free between their steps and may be given up there.
    The full torque is the share of full duty that each joint may use at most, shape (joints,); a survey lowers it.
    """

    def __init__(self, joint_names: tuple[str, ...], full_torque: Vector) -> None:
        self.joint_names = joint_names
        self.full_torque = full_torque
        self.needs_survey = False  # from the first write of a calibration until the next survey; enabling is refused
        self.latched_status = StatusFlag.OVERLOAD  # status flags that last until they are cleared
        self.counters: BusCounters | None = None  # events on the bus; None for hardware without one
        self.world: World | None = None  # world that moves a simulated arm's joints; None without physics
        self.round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS_KEPT)  # durations of the latest reads

    @abstractmethod
    def survey(self) -> Steps[Survey]:
        """Survey every actuator without writing to it.

        Raises StartupError where actuators cannot be taken over in their present state; the text says which, and what
        to do. Raises DescriptionError where an actuator's own limits leave nothing of its joint's range.
        """

    @abstractmethod
    def read(self) -> Measured | None:
        """Read every joint once; return None until each has answered."""

    @abstractmethod
    def write_goals(self, goal_rad: Vector) -> None:
        """Write the joints' goals, shape (joints,) [rad]."""

    @abstractmethod
    def write_torque_shares(self, torque_share: Vector) -> None:
        """Write the joints' torque limits where they have changed: shares of full duty, 0 to 1, shape (joints,)."""

    @abstractmethod
    def check(self, stamp_s: float) -> Fault | None:
        """Check one actuator, in turn, against what was written to it; None when it agrees or none is due."""

    @abstractmethod
    def driven(self) -> Steps[Flags]:
        """Read the joints whose torque is on, shape (joints,)."""

    @abstractmethod
    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        """Switch torque on at some indices without a jump; joints that hold already keep their goals.

        Return the goals of all joints, positions for those that do not hold, shape (joints,) [rad]. Raises StartupError
        where the arm moves, stands outside its limits or does not take a value; then, and after NoReply, joints relaxed
        before are relaxed again.
        """

    @abstractmethod
    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        """Lower torque from shares, shape (joints,), and switch it off; return labels of joints perhaps driven."""

    @abstractmethod
    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        """Switch torque off at some indices, or everywhere; return labels of joints that may still be driven."""

    @abstractmethod
    def cut_torque(self) -> Steps[list[str]]:
        """Switch all torque off at once, with the first step; then as :meth:`switch_off`."""

    @abstractmethod
    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        """Clear latched status flags where joints are; return all goals, shape (joints,) [rad], None if none holds."""

    def write_calibration(self, calibration: Calibration) -> Steps[str]:
        """Write a calibration into relaxed actuators; return a sentence. Raises OrderRefused or StartupError."""
        yield 0.0
        raise OrderRefused(CALIBRATION_NOT_KEPT)

    @abstractmethod
    def health(self, joint: int) -> JointHealth:
        """Return the health of the actuator at an index of the arrays, without its latest readings."""

    @abstractmethod
    def label(self, joint: int) -> str:
        """Return a label of the joint and its actuator for people."""

    @abstractmethod
    def close(self) -> None:
        """Release the actuators; they keep their goals."""


def run_to_end(steps: Steps[Result], wait: Callable[[float], None] = time.sleep) -> Result:
    """Run a sequence on hardware without a control loop, and return its result; ``wait`` waits for a time [s].

    An exception of ``wait``, as Ctrl-C, ends the sequence at once, so that it can undo the half that is done.
    """
    with contextlib.closing(steps):
        while True:
            try:
                wait_s = next(steps)
            except StopIteration as end:
                result: Result = end.value
                return result
            wait(wait_s)
