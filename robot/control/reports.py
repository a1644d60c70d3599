"""Reports of one arm to the server: its state many times a second, and its health once a second."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from robot.advice import ServoAlert, ServoWarning
from robot.control.cycle import ControlCycle
from robot.control.pacing import LoopClock, Pacer, percentiles
from robot.control.realtime import Scheduling
from robot.faults import Fault
from robot.messages import ArmHealth, ArmState, JointHealth, Mode, Pace


def disconnected(joint_names: tuple[str, ...], reason: str, fault: Fault | None, clock_s: float) -> ArmState:
    """Build the state of an arm whose hardware is not open."""
    return ArmState(time.time(), Mode.DISCONNECTED, joint_names, reason=reason, fault=fault, clock_s=clock_s)


def arm_state(
    arm: ControlCycle, mode: Mode, fault: Fault | None, reason: str, lateness_s: tuple[float, ...], clock_s: float
) -> ArmState:
    """Build the state of the arm at its latest reading.

    The reason is a sentence on an arm that is connected but not ready; the lateness is of the ticks since the last
    state.
    """
    measured, controller = arm.measured, arm.controller
    if measured is None:
        return ArmState(
            time.time(),
            mode,
            arm.hardware.joint_names,
            reason=reason,
            fault=fault,
            lateness_s=lateness_s,
            clock_s=clock_s,
        )
    motion = None if controller is None else controller.motion
    torque_enabled = controller is not None and controller.torque_enabled
    return ArmState(
        measured.stamp_s,
        mode,
        arm.hardware.joint_names,
        reason=reason,
        position_rad=measured.position_rad,
        velocity_rad_s=measured.velocity_rad_s,
        age_s=measured.age_s,
        load=measured.load,
        current_a=measured.current_a,
        goal_rad=controller.goal_rad if controller is not None and torque_enabled else measured.position_rad,
        motion_id=None if motion is None else motion.motion_id,
        fraction=0.0 if motion is None else motion.fraction,
        remaining_s=0.0 if motion is None else motion.remaining_s,
        motions=() if controller is None else controller.progress,
        pace=Pace() if controller is None else controller.pace,
        lateness_s=lateness_s,
        fault=fault,
        clock_s=clock_s,
        torque_enabled=torque_enabled,
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
        limits_rad=None if bounds is None else np.stack((bounds.lower_rad, bounds.upper_rad), axis=1),
        fault=state.fault,
        reason=state.reason,
    )


def _joint_health(arm: ControlCycle, joint: int) -> JointHealth:
    condition, measured, controller = arm.hardware.condition(joint), arm.measured, arm.controller
    readings: dict[str, Any] = {"age_s": condition.age_s}
    if measured is not None and controller is not None:
        readings |= {
            "position_rad": float(measured.position_rad[joint]),
            "temperature_c": float(measured.temperature_c[joint]),
            "voltage_v": float(measured.voltage_v[joint]),
            "current_a": float(measured.current_a[joint]),
            "load": float(measured.load[joint]),
            "torque_enabled": condition.torque_enabled,
            "status": int(measured.status[joint]),
            "age_s": float(measured.age_s[joint]),
            "warnings": condition.warnings + controller.guards.warnings(measured, joint),
        }
    elif math.isinf(condition.age_s):
        readings["warnings"] = (ServoWarning(ServoAlert.NO_ANSWER, "it has not answered yet"),)
    return JointHealth(
        joint=arm.hardware.joint_names[joint],
        hardware_id=condition.hardware_id,
        silent_cycles=condition.silent_cycles,
        errors=arm.errors.of(joint),
        registers=condition.registers,
        expected=condition.expected,
        **readings,
    )
