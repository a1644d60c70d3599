"""What the server is told of the arm: its state many times a second, its condition once."""

from __future__ import annotations

import time

import numpy as np

from robot.control.arm_on_bus import ArmOnBus
from robot.control.pacing import Pacer, percentiles
from robot.faults import Fault
from robot.messages import ArmHealth, ArmState, Mode, Pace, ServoHealth
from robot.servos.servo_map import ServoMap


def disconnected(servos: ServoMap, reason: str, fault: Fault | None) -> ArmState:
    """The state of an arm whose bus is not open."""
    return ArmState(time.time(), Mode.DISCONNECTED, servos.names, reason=reason, fault=fault)


def arm_state(arm: ArmOnBus, mode: Mode, fault: Fault | None, reason: str, lateness_s: tuple[float, ...]) -> ArmState:
    """The arm at its latest reading."""
    measured, driver = arm.measured, arm.driver
    if measured is None:
        return ArmState(time.time(), mode, arm.servos.names, reason=reason, fault=fault, lateness_s=lateness_s)
    motion = driver.motion if driver is not None else None
    return ArmState(
        stamp_s=measured.stamp_s,
        mode=mode,
        joint_names=arm.servos.names,
        reason=reason,
        position_rad=measured.position_rad,
        velocity_rad_s=measured.velocity_rad_s,
        age_s=measured.age_s,
        load=measured.load,
        current_a=measured.current_a,
        goal_rad=driver.goal_rad if driver is not None and driver.driven else measured.position_rad,
        motion_id=motion.motion_id if motion is not None else None,
        fraction=motion.fraction if motion is not None else 0.0,
        remaining_s=motion.remaining_s if motion is not None else 0.0,
        pace=driver.pace if driver is not None else Pace(),
        lateness_s=lateness_s,
        fault=fault,
    )


def arm_health(
    arm: ArmOnBus, mode: Mode, fault: Fault | None, reason: str, port: str, pacer: Pacer, *, real_time: bool
) -> ArmHealth:
    """The arm's condition now."""
    driver = arm.driver
    limits = None if driver is None else np.stack((driver.bounds.lower_rad, driver.bounds.upper_rad), axis=1)
    return ArmHealth(
        stamp_s=time.time(),
        mode=mode,
        port=port,
        servos=tuple(_servo_health(arm, joint) for joint in range(len(arm.servos.ids))),
        bus=arm.bus.counters,
        lateness_s=percentiles(pacer.lateness_s),
        round_trip_s=percentiles(arm.round_trips_s),
        real_time=real_time,
        limits_rad=limits,
        fault=fault,
        reason=reason,
    )


def _servo_health(arm: ArmOnBus, joint: int) -> ServoHealth:
    servo, measured, driver = arm.servos.ids[joint], arm.measured, arm.driver
    if measured is None or driver is None or arm.upkeep is None:
        return _unread(arm, joint)
    return ServoHealth(
        joint=arm.servos.names[joint],
        servo_id=servo,
        position_rad=float(measured.position_rad[joint]),
        temperature_c=int(measured.temperature_c[joint]),
        voltage_v=float(measured.voltage_v[joint]),
        current_a=float(measured.current_a[joint]),
        load=float(measured.load[joint]),
        torque_enabled=arm.upkeep.torque_on.get(servo),
        status=int(measured.status[joint]),
        age_s=float(measured.age_s[joint]),
        silent_cycles=arm.watch.silent_cycles[servo],
        warnings=arm.upkeep.warnings(servo) + driver.guards.warnings(measured, joint),
    )


def _unread(arm: ArmOnBus, joint: int) -> ServoHealth:
    """A servo of an arm that is still being checked."""
    servo = arm.servos.ids[joint]
    age_s = arm.watch.age_s(servo, time.monotonic())
    return ServoHealth(
        joint=arm.servos.names[joint],
        servo_id=servo,
        position_rad=float("nan"),
        temperature_c=0,
        voltage_v=0.0,
        current_a=0.0,
        load=0.0,
        torque_enabled=None,
        status=0,
        age_s=age_s,
        silent_cycles=arm.watch.silent_cycles[servo],
        warnings=() if age_s < float("inf") else ("it has not answered yet",),
    )
