"""Reports to the server: the arm's state many times a second, its health once a second."""

from __future__ import annotations

import time

import numpy as np

from robot.control.cycle import ControlCycle
from robot.control.pacing import Pacer, percentiles
from robot.faults import Fault
from robot.hardware.clock import LoopClock
from robot.messages import ArmHealth, ArmState, JointHealth, Mode, Pace


def disconnected(joint_names: tuple[str, ...], reason: str, fault: Fault | None, clock_s: float) -> ArmState:
    """Build the state of an arm whose hardware is not open."""
    return ArmState(time.time(), Mode.DISCONNECTED, joint_names, reason=reason, fault=fault, clock_s=clock_s)


def arm_state(
    arm: ControlCycle, mode: Mode, fault: Fault | None, reason: str, lateness_s: tuple[float, ...], clock_s: float
) -> ArmState:
    """Build the state of the arm at its latest reading.

    Args:
        arm: control cycle of the arm.
        mode: state of its state machine.
        fault: latched fault.
        reason: sentence on an arm that is connected but not ready.
        lateness_s: lateness of the ticks since the last state [s].
        clock_s: time of the control loop [s].
    """
    measured, controller, names = arm.measured, arm.controller, arm.hardware.joint_names
    if measured is None:
        return ArmState(time.time(), mode, names, reason=reason, fault=fault, lateness_s=lateness_s, clock_s=clock_s)
    motion = controller.motion if controller is not None else None
    driven = controller is not None and controller.driven
    return ArmState(
        stamp_s=measured.stamp_s,
        mode=mode,
        joint_names=names,
        reason=reason,
        position_rad=measured.position_rad,
        velocity_rad_s=measured.velocity_rad_s,
        age_s=measured.age_s,
        load=measured.load,
        current_a=measured.current_a,
        goal_rad=controller.goal_rad if controller is not None and driven else measured.position_rad,
        motion_id=motion.motion_id if motion is not None else None,
        fraction=motion.fraction if motion is not None else 0.0,
        remaining_s=motion.remaining_s if motion is not None else 0.0,
        pace=controller.pace if controller is not None else Pace(),
        lateness_s=lateness_s,
        fault=fault,
        clock_s=clock_s,
        driven=driven,
    )


def arm_health(
    arm: ControlCycle,
    state: ArmState,
    port: str,
    pacer: Pacer,
    clock: LoopClock,
    *,
    real_time: bool,
) -> ArmHealth:
    """Build the report of the arm's health.

    Args:
        arm: control cycle of the arm.
        state: its state now.
        port: name of its port.
        pacer: pacer of the control loop.
        clock: clock of the control loop.
        real_time: True if the process has real-time priority.
    """
    controller = arm.controller
    bounds = None if controller is None else controller.bounds
    limits = None if bounds is None else np.stack((bounds.lower_rad, bounds.upper_rad), axis=1)
    return ArmHealth(
        stamp_s=time.time(),
        mode=state.mode,
        port=port,
        joints=tuple(_joint_health(arm, joint) for joint in range(len(arm.hardware.joint_names))),
        bus=arm.hardware.counters,
        lateness_s=percentiles(pacer.lateness_s),
        round_trip_s=percentiles(arm.hardware.round_trips_s),
        real_time=real_time,
        real_time_factor=clock.real_time_factor,
        limits_rad=limits,
        fault=state.fault,
        reason=state.reason,
    )


def _joint_health(arm: ControlCycle, joint: int) -> JointHealth:
    condition, measured, controller = arm.hardware.condition(joint), arm.measured, arm.controller
    if measured is None or controller is None:
        never_heard = condition.age_s == float("inf")
        return JointHealth(
            joint=arm.hardware.joint_names[joint],
            hardware_id=condition.hardware_id,
            position_rad=float("nan"),
            temperature_c=float("nan"),
            voltage_v=float("nan"),
            current_a=float("nan"),
            load=float("nan"),
            torque_enabled=None,
            status=0,
            age_s=condition.age_s,
            silent_cycles=condition.silent_cycles,
            warnings=("it has not answered yet",) if never_heard else (),
        )
    return JointHealth(
        joint=arm.hardware.joint_names[joint],
        hardware_id=condition.hardware_id,
        position_rad=float(measured.position_rad[joint]),
        temperature_c=float(measured.temperature_c[joint]),
        voltage_v=float(measured.voltage_v[joint]),
        current_a=float(measured.current_a[joint]),
        load=float(measured.load[joint]),
        torque_enabled=condition.torque_enabled,
        status=int(measured.status[joint]),
        age_s=float(measured.age_s[joint]),
        silent_cycles=condition.silent_cycles,
        warnings=condition.warnings + controller.guards.warnings(measured, joint),
    )
