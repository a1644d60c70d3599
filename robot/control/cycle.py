"""Control cycle of the arm (read, update, write, as in ros2_control's controller manager), and the reports on it."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from robot.control.controller import ArmController
from robot.control.pacing import LoopClock, Pacer, Scheduling, percentiles
from robot.faults import Fault, FaultCode, ServoAlert, ServoWarning
from robot.hardware.interface import HardwareInterface, Measured, status_names
from robot.messages import ArmHealth, ArmState, JointHealth, Mode, MotionEnded
from robot.trajectory import Vector

SAME_ERROR_S = 5.0  # a register check repeats what it finds, about once a second, until the servo is driven again

# Findings of register checks that are counted.
_FOUND = {FaultCode.SERVO_REBOOTED: ServoAlert.SERVO_REBOOTED, FaultCode.TORQUE_LOST: ServoAlert.TORQUE_LOST}


class ErrorCounts:
    """Errors of one arm's actuators: status flags each time they come up, lasting findings of register checks once."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._joints = {name: joint for joint, name in enumerate(joint_names)}
        self._counts: list[Counter[str]] = [Counter() for _ in joint_names]
        self._status = [0] * len(joint_names)
        self._found_s: dict[str, float] = {}

    def observe(self, measured: Measured) -> None:
        """Count the status flags that have come up since the last readings."""
        status = measured.status.tolist()
        if status == self._status:
            return
        for joint, (word, before) in enumerate(zip(status, self._status, strict=True)):
            self._counts[joint].update(status_names(word & ~before))
        self._status = status

    def add_finding(self, fault: Fault, now_s: float) -> None:
        """Count what a register check has found."""
        alert, joint = _FOUND.get(fault.code), self._joints.get(fault.joint)
        if alert is None or joint is None:
            return
        last_s = self._found_s.get(fault.joint)
        if last_s is None or now_s - last_s > SAME_ERROR_S:
            self._counts[joint][alert.value] += 1
        self._found_s[fault.joint] = now_s

    def of(self, joint: int) -> Mapping[str, int]:
        """Return the counts of the joint at an index of the arrays, by kind."""
        return dict(self._counts[joint])


class ControlCycle:
    """Control cycle on open hardware; a fault may be latched before it has a controller."""

    def __init__(self, hardware: HardwareInterface, clock: Callable[[], float], fault: Fault | None = None) -> None:
        self.hardware = hardware
        self.controller: ArmController | None = None  # None until the actuators were surveyed
        self.measured: Measured | None = None  # latest readings; None until every joint has answered
        self.errors = ErrorCounts(hardware.joint_names)
        self._clock = clock
        self._early_fault = fault
        self._writing = True

    @property
    def fault(self) -> Fault | None:
        return self._early_fault if self.controller is None else self.controller.fault

    def latch(self, fault: Fault) -> list[MotionEnded]:
        """Latch a fault; return the ends of motions."""
        if self.controller is None:
            self._early_fault = fault
            return []
        return self.controller.latch(fault)

    def tick(self) -> list[MotionEnded]:
        """Read the joints, update the controller, and write the goals; return the ends of motions."""
        measured = self.hardware.read()
        self.measured = measured
        controller = self.controller
        if measured is not None:
            self.errors.observe(measured)
        if controller is None or measured is None:
            return []
        ended = controller.step(measured, self._clock())
        if controller.torque_enabled and self._writing:
            self.hardware.write_goals(controller.goal_rad)
            self.hardware.write_torque_shares(controller.torque_limit)
        fault = self.hardware.check(measured.stamp_s)
        if fault is not None and controller.torque_enabled:
            self.errors.add_finding(fault, self._clock())
            ended += controller.react(fault, measured)
        return ended

    def hold(self, goal_rad: Vector) -> None:
        """Let the controller hold at goals that were written at full torque; goals far from the arm return to it."""
        if self.controller is not None:
            self.controller.hold(goal_rad, self.measured)

    @contextmanager
    def writing_paused(self) -> Iterator[None]:
        """Suspend the ticks' writes while a sequence writes goals of its own."""
        self._writing = False
        try:
            yield
        finally:
            self._writing = True


def arm_state(arm: ControlCycle, mode: Mode, reason: str, lateness_s: tuple[float, ...], clock: LoopClock) -> ArmState:
    """Build the state of the arm at its latest reading; the reason is a sentence on an arm that is not ready."""
    measured, controller = arm.measured, arm.controller
    state = ArmState(
        clock.stamp_s(time.time() if measured is None else measured.stamp_s),
        mode,
        arm.hardware.joint_names,
        reason=reason,
        fault=arm.fault,
        lateness_s=lateness_s,
        clock_s=clock(),
    )
    if measured is None:
        return state
    state = replace(
        state,
        position_rad=measured.position_rad,
        velocity_rad_s=measured.velocity_rad_s,
        age_s=measured.age_s,
        load=measured.load,
        current_a=measured.current_a,
        goal_rad=measured.position_rad,
    )
    if controller is None:
        return state
    return replace(
        state,
        goal_rad=controller.goal_rad,
        motions=controller.progress,
        pace=controller.pace,
        torque_enabled=controller.torque_enabled,
    )


def arm_health(
    arm: ControlCycle, state: ArmState, port: str, pacer: Pacer, clock: LoopClock, scheduling: Scheduling
) -> ArmHealth:
    """Build the report of the arm's health."""
    bounds = None if arm.controller is None else arm.controller.bounds
    return ArmHealth(
        monotonic_s=time.monotonic(),
        mode=state.mode,
        port=port,
        joints=tuple(_joint_health(arm, joint) for joint in range(len(arm.hardware.joint_names))),
        bus=arm.hardware.counters,
        lateness_s=percentiles(pacer.lateness_s),
        round_trip_s=percentiles(arm.hardware.round_trips_s),
        real_time=scheduling.real_time,
        memory_locked=scheduling.memory_locked,
        real_time_factor=clock.real_time_factor,
        rate=clock.rate,
        limits_rad=None if bounds is None else np.stack((bounds.lower_rad, bounds.upper_rad), axis=1),
        fault=state.fault,
        reason=state.reason,
    )


def _joint_health(arm: ControlCycle, joint: int) -> JointHealth:
    measured, controller = arm.measured, arm.controller
    health = replace(arm.hardware.health(joint), errors=arm.errors.of(joint))
    if measured is not None and controller is not None:
        return replace(
            health,
            position_rad=float(measured.position_rad[joint]),
            temperature_c=float(measured.temperature_c[joint]),
            voltage_v=float(measured.voltage_v[joint]),
            current_a=float(measured.current_a[joint]),
            load=float(measured.load[joint]),
            status=int(measured.status[joint]),
            age_s=float(measured.age_s[joint]),
            warnings=health.warnings + controller.guards.warnings(measured, joint),
        )
    if math.isinf(health.age_s):
        return replace(health, warnings=(ServoWarning(ServoAlert.NO_ANSWER, "it has not answered yet"),))
    return replace(health, torque_enabled=None, warnings=())
