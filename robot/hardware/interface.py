"""Sequences that share the hardware with the 100 Hz tick: each step is one transaction, or a wait.

A sequence is a generator. It yields before every transaction, so that nothing holds up a tick or an emergency stop
for longer than one of them, and the number it yields is how long it wants to wait first [s].

The seam between the controller and an arm's actuators, as ros2_control's hardware interface is one.

Everything that crosses it is in SI units and arrays of shape (joints,), in the order of ``joint_names``; prismatic
joints are in metres where names say radians. Ticks, registers and packets live below it.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from robot.description.limits import JointBounds
from robot.faults import Fault
from robot.trajectory import Vector

Result = TypeVar("Result")
Steps: TypeAlias = Generator[float, None, Result]

Flags: TypeAlias = NDArray[np.bool_]

# Round trips of the last second at 100 Hz.
ROUND_TRIPS_KEPT = 100

# No joint turns by so much in a cycle (300 ticks of an STS3215, 46 rad/s); longer gaps allow for the free speed of an
# STS3215 at 7.4 V.
JUMP_RAD = 0.46
FREE_SPEED_RAD_S = 5.5


class StatusFlag(IntFlag):
    """Complaints of an actuator; the values are the bits of register STATUS of Feetech's STS3215."""

    VOLTAGE = 1
    ENCODER = 2
    TEMPERATURE = 4
    CURRENT = 8
    ANGLE = 16
    OVERLOAD = 32


def status_names(status: int) -> list[str]:
    """Name the flags of a status word, lowest first; bits that are not documented are left out."""
    return [str(flag.name).lower() for flag in StatusFlag if status & flag]


class Measured(NamedTuple):
    """The last good reading of every joint, each of shape (joints,); NaN where the hardware does not measure it.

    Attributes:
        position_rad: [rad].
        velocity_rad_s: [rad/s].
        load: share of full motor duty, signed.
        current_a: motor current, signed [A].
        voltage_v: supply [V].
        temperature_c: of the motors [degC].
        status: bits of :class:`StatusFlag`.
        age_s: how old the readings are [s].
        stamp_s: wall-clock time of the tick [s since the epoch], one number.
    """

    position_rad: Vector
    velocity_rad_s: Vector
    load: Vector
    current_a: Vector
    voltage_v: Vector
    temperature_c: Vector
    status: NDArray[np.int_]
    age_s: Vector
    stamp_s: float = 0.0


@dataclass(frozen=True)
class Survey:
    """Actuators as they were found; nothing was written to them.

    Attributes:
        bounds: the soft limits, narrowed to what the actuators' own limits let them reach.
        driven: joints whose torque is on.
        goal_rad: where those are told to be, NaN for the others [rad].
        max_voltage_v: highest supply that each may have; infinite where there is no such limit [V].
    """

    bounds: JointBounds
    driven: Flags
    goal_rad: Vector
    max_voltage_v: Vector


@dataclass
class BusCounters:
    """Events on the bus since it was opened.

    Attributes:
        sent: instructions written.
        replies: valid replies received.
        timeouts: replies that were expected and did not come, or not soundly.
        discarded_bytes: bytes that belonged to no valid reply.
        retries: instructions repeated because the servo gave no valid reply.
    """

    sent: int = 0
    replies: int = 0
    timeouts: int = 0
    discarded_bytes: int = 0
    retries: int = 0


@dataclass(frozen=True)
class Condition:
    """One actuator's condition beyond its readings.

    Attributes:
        hardware_id: its name in diagnostics, as ``servo 3``.
        torque_enabled: whether its torque was found on when it was last looked at; None before.
        age_s: time since its last good reading, infinite before the first [s].
        silent_cycles: cycles in which it did not answer.
        warnings: findings of the survey that a person should look after, a sentence each.
    """

    hardware_id: str
    torque_enabled: bool | None
    age_s: float
    silent_cycles: int
    warnings: tuple[str, ...] = ()


class HardwareInterface(ABC):
    """Actuators of one arm, from opening to :meth:`close`.

    Every method may raise PortLost when the connection to the actuators is gone. Sequences (``Steps``) leave the
    hardware free between their steps and may be given up there.

    Args:
        joint_names: order of every array.
        full_torque: share of full duty that each joint may use at most, shape (joints,).

    Attributes:
        joint_names: as given.
        full_torque: as given.
        counters: events on the bus; None for hardware without one.
        round_trips_s: durations of the latest reads [s].
    """

    def __init__(self, joint_names: tuple[str, ...], full_torque: Vector) -> None:
        self.joint_names = joint_names
        self.full_torque = full_torque
        self.counters: BusCounters | None = None
        self.round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS_KEPT)

    @abstractmethod
    def survey(self) -> Steps[Survey]:
        """Find every actuator, and what it is doing; writes nothing.

        Raises:
            StartupError: actuators that cannot be taken over as they are; says which, and what to do.
            NoReply: an actuator fell silent on the way.
            DescriptionError: an actuator's own limits leave nothing of its joint's range.
        """

    @abstractmethod
    def read(self) -> Measured | None:
        """Read every joint once; None until each has been heard."""

    @abstractmethod
    def write_goals(self, goal_rad: Vector) -> None:
        """Tell the joints their goals, shape (joints,) [rad]."""

    @abstractmethod
    def write_torque_shares(self, torque_share: Vector) -> None:
        """Bound the torque that each joint may use, shape (joints,); what it has been told already is not repeated.

        Args:
            torque_share: shares of full motor duty, 0 to 1.
        """

    @abstractmethod
    def check(self, stamp_s: float) -> Fault | None:
        """Look whether the joint whose turn it is still is as it was told, at most one a call.

        Args:
            stamp_s: wall-clock time for the fault [s since the epoch].
        """

    @abstractmethod
    def driven(self) -> Steps[Flags]:
        """Ask every joint whether its torque is on, shape (joints,).

        Raises:
            NoReply: a joint does not say.
        """

    @abstractmethod
    def enable(self, joints: Sequence[int]) -> Steps[Vector]:
        """Bring joints to hold where they are, without a jump; those that hold already keep their goals.

        Args:
            joints: places in the arrays; the others are only looked at.

        Returns:
            The goals of all joints; for one that is not held, where it is, shape (joints,) [rad].

        Raises:
            StartupError: the arm moves, stands outside its limits or does not obey; what was relaxed is relaxed again.
            NoReply: a joint does not answer; as above.
        """

    @abstractmethod
    def relax(self, torque_share: Vector) -> Steps[list[str]]:
        """Lower the torque, then switch it off and see that it is.

        Args:
            torque_share: shares to begin with, shape (joints,).

        Returns:
            Labels of the joints that may still be driven.
        """

    @abstractmethod
    def switch_off(self, joints: Sequence[int] | None = None) -> Steps[list[str]]:
        """Switch torque off and see that it is; returns labels of the joints that may still be driven.

        Args:
            joints: places in the arrays; None for all.
        """

    @abstractmethod
    def cut_torque(self) -> Steps[list[str]]:
        """Switch all torque off at once, with the first step; then as :meth:`switch_off`."""

    @abstractmethod
    def clear_overloads(self, joints: Sequence[int], *, hold: bool) -> Steps[Vector | None]:
        """Clear latched overloads: torque off, and on again at the present position.

        Args:
            joints: places of the overloaded joints.
            hold: whether the arm holds; else torque is off at the end.

        Returns:
            The goals of all joints, shape (joints,) [rad]; None where nothing holds.

        Raises:
            StartupError: a joint does not do as it is told.
            NoReply: a joint does not answer.
        """

    @abstractmethod
    def condition(self, joint: int) -> Condition:
        """Condition of the joint at a place in the arrays."""

    @abstractmethod
    def label(self, joint: int) -> str:
        """Name a joint for people, with whatever tells its actuator."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the actuators; they keep doing what they were told."""


def run_to_end(steps: Steps[Result], wait: Callable[[float], None] = time.sleep) -> Result:
    """Carry out a sequence on hardware that nobody else uses, as the command line does; returns what it returns.

    Args:
        steps: the sequence; what it raises is raised.
        wait: waits for so long [s].
    """
    while True:
        try:
            wait_s = next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
        wait(wait_s)
