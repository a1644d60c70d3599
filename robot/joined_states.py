"""States and health of several arms as those of one, whose joints are the joints of all of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np

from robot.faults import Fault
from robot.hardware.interface import BusCounters
from robot.messages import ArmHealth, ArmState, Mode
from robot.trajectory import Vector

# What several arms together are is what most keeps them from moving.
_BY_WEIGHT = (Mode.FAULT, Mode.DISCONNECTED, Mode.CONNECTED, Mode.MOVING, Mode.RELAXED, Mode.HOLDING)


def joined_state(
    states: Mapping[str, ArmState],
    last_read: Mapping[str, ArmState] | None = None,
    leaders: Collection[str] = (),
) -> ArmState:
    """Return the state of several arms as that of one.

    Args:
        states: latest state of each, by the name of the arm.
        leaders: arms that are relaxed to be moved by hand, which keeps none of the others from moving.
        last_read: latest state with readings of each arm that has ever been read, in place of the one without
            readings; None for the joints of the arms alone that are read at present.

    Returns:
        A state whose mode is that of the arm which most keeps them from moving. Its joints have no positions while one
        of those asked for has none.
    """
    present = list(states.values())
    known = [_with_readings(name, state, last_read) for name, state in states.items()]
    if last_read is None:
        known = [state for state in known if state.position_rad is not None]
    # Joints of an arm that does not move are held, or stay, where they are read.
    driven = any(state.goal_rad is not None for state in known)
    leading = max((state for state in present if state.motions), key=lambda state: state.remaining_s, default=None)
    modes = [state.mode for name, state in states.items() if name not in leaders or state.mode is not Mode.RELAXED]
    # The latest by the arms' clocks, because that of the machine may be set; that of a lost arm stands still.
    connected = [state for state in present if state.mode is not Mode.DISCONNECTED]
    latest = max(connected or present, key=lambda state: state.clock_s)
    return ArmState(
        stamp_s=latest.stamp_s,
        mode=min(modes or [Mode.RELAXED], key=_BY_WEIGHT.index),
        joint_names=tuple(name for state in known for name in state.joint_names),
        reason="; ".join(f"{name}: {state.reason}" for name, state in states.items() if state.reason),
        fault=next((_named(name, state.fault) for name, state in states.items() if state.fault is not None), None),
        position_rad=_joined(known, lambda state: state.position_rad),
        velocity_rad_s=_joined(known, lambda state: state.velocity_rad_s),
        age_s=_joined(
            known, lambda state: None if state.age_s is None else state.age_s + (latest.clock_s - state.clock_s)
        ),
        load=_joined(known, lambda state: state.load),
        current_a=_joined(known, lambda state: state.current_a),
        goal_rad=_joined(known, _held_rad) if driven else None,
        motion_id=None if leading is None else leading.motion_id,
        fraction=0.0 if leading is None else leading.fraction,
        remaining_s=0.0 if leading is None else leading.remaining_s,
        motions=tuple(motion for state in present for motion in state.motions),
        pace=replace((leading or present[0]).pace, speed_limit=min(state.pace.speed_limit for state in present)),
        lateness_s=tuple(late_s for state in present for late_s in state.lateness_s),
        clock_s=min(state.clock_s for state in present),
        driven=all(state.driven for state in present),
    )


def joined_health(reports: Mapping[str, ArmHealth]) -> ArmHealth:
    """Return the health of several arms as that of one; figures of loops are those of the worst."""
    all_of = list(reports.values())
    limits_rad = [each.limits_rad for each in all_of if each.limits_rad is not None]
    buses = [each.bus for each in all_of if each.bus is not None]
    worst_mode = min((each.mode for each in all_of), key=_BY_WEIGHT.index)
    return ArmHealth(
        monotonic_s=min(each.monotonic_s for each in all_of),
        mode=worst_mode,
        port=", ".join(dict.fromkeys(each.port for each in all_of)),
        joints=tuple(joint for each in all_of for joint in each.joints),
        bus=_summed(buses) if buses else None,
        lateness_s=_greatest([each.lateness_s for each in all_of]),
        round_trip_s=_greatest([each.round_trip_s for each in all_of]),
        real_time=all(each.real_time for each in all_of),
        real_time_factor=min(each.real_time_factor for each in all_of),
        memory_locked=all(each.memory_locked for each in all_of),
        limits_rad=np.concatenate(limits_rad) if len(limits_rad) == len(all_of) else None,
        fault=next((_named(name, each.fault) for name, each in reports.items() if each.fault is not None), None),
        reason="; ".join(f"{name}: {each.reason}" for name, each in reports.items() if each.reason),
    )


def _with_readings(name: str, state: ArmState, last_read: Mapping[str, ArmState] | None) -> ArmState:
    return state if state.position_rad is not None or last_read is None else last_read.get(name, state)


def _held_rad(state: ArmState) -> Vector | None:
    return state.position_rad if state.goal_rad is None else state.goal_rad


def _joined(states: list[ArmState], array_of: Callable[[ArmState], Vector | None]) -> Vector | None:
    """Return an array of all joints; None while one arm has none."""
    arrays = [array for state in states if (array := array_of(state)) is not None]
    return np.concatenate(arrays) if arrays and len(arrays) == len(states) else None


def _named(name: str, fault: Fault | None) -> Fault | None:
    """Return a fault whose sentence says which arm has it."""
    return None if fault is None else replace(fault, message=f"{name}: {fault.message}")


def _summed(buses: list[BusCounters]) -> BusCounters:
    return BusCounters(*(sum(values) for values in zip(*(vars(bus).values() for bus in buses), strict=True)))


def _greatest(figures: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    p50, p99, greatest = (max(values) for values in zip(*figures, strict=True))
    return p50, p99, greatest
