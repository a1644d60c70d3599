"""Invariants of every run: each check returns one sentence per violation."""

import bisect
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from harness.write_log import Entry, pairs
from robot.control.controller import STEP_MARGIN
from robot.control.pacing import MAX_TICK_S
from robot.description.limits import JointBounds, within_calibration
from robot.description.robot_folder import built_in
from robot.messages import ArmState
from tests.processes.campaign.scenario import CALIBRATION

# Torque must come on with the joint at its goal.
TORQUE_ON_WITHIN_TICKS = 30

# Goals are whole ticks: a bound may be missed by the rounding of both ends.
ROUNDING_TICKS = 2

# A servo without a write for longer than this ends every motion: its next goal is no further on.
DEAF_S = 0.15

# Between the request and the end of the replies; the log has the true positions only at writes.
BEFORE_READING_S = 0.02
AFTER_READING_S = 0.06
READING_WITHIN_TICKS = 4

# Delay between an event and its arrival at the campaign.
HEARD_LATE_S = 0.15

_JOINTS = {joint.servo_id: joint for joint in CALIBRATION.joints}
_NAMES = tuple(joint.joint for joint in CALIBRATION.joints)
_BOUNDS = JointBounds.of(within_calibration(built_in("so101").model, CALIBRATION), _NAMES)


def _ticks_s(servo: int) -> float:
    """Return the joint's velocity limit [ticks/s]."""
    velocity = _BOUNDS.max_velocity[list(_JOINTS).index(servo)]
    return abs(_JOINTS[servo].ticks_s_from_rad_s(float(velocity)))


def _soft_limits(servo: int) -> tuple[int, int]:
    """Return the joint's soft limits [ticks]."""
    joint, column = _JOINTS[servo], list(_JOINTS).index(servo)
    ends = (joint.ticks_from_rad(_BOUNDS.lower_rad[column]), joint.ticks_from_rad(_BOUNDS.upper_rad[column]))
    return min(ends), max(ends)


_SPEED: Mapping[int, float] = {servo: _ticks_s(servo) for servo in _JOINTS}
_LIMITS: Mapping[int, tuple[int, int]] = {servo: _soft_limits(servo) for servo in _JOINTS}


def goal_steps(entries: list[Entry]) -> list[str]:
    """No goal of a driven servo steps by more than the velocity bound allows."""
    told_s = dict.fromkeys(_JOINTS, entries[0].at_s if entries else 0.0)
    found = []
    for before, after in pairs(entries):
        for servo in _JOINTS:
            if "GOAL_POSITION" not in after.written.get(servo, ()):
                continue
            elapsed_s = after.at_s - told_s[servo] + MAX_TICK_S
            told_s[servo] = after.at_s
            step = abs(after.goal[servo] - before.goal[servo])
            bound = STEP_MARGIN * _SPEED[servo] * min(elapsed_s, DEAF_S) + ROUNDING_TICKS
            if _driven(before, servo) and _driven(after, servo) and step > bound:
                found.append(f"goal of servo {servo} stepped by {step} ticks at {after.at_s:.3f}, {bound:.0f} allowed")
    return found


def limits(entries: list[Entry]) -> list[str]:
    """No goal of a driven servo goes beyond the soft limits, or further beyond than where it was switched on."""
    outside = dict.fromkeys(_JOINTS, 0)
    found = []
    for before, after in pairs(entries):
        for servo in _JOINTS:
            lowest, highest = _LIMITS[servo]
            beyond = max(lowest - after.goal[servo], after.goal[servo] - highest, 0)
            driven = _driven(after, servo)
            if driven and _driven(before, servo) and beyond > outside[servo] + ROUNDING_TICKS:
                found.append(f"goal of servo {servo} went to {after.goal[servo]}, beyond {lowest} to {highest}")
            outside[servo] = beyond if driven else 0
    return found


def torque_on(entries: list[Entry]) -> list[str]:
    """Torque is never switched on with the joint away from its goal."""
    return [
        f"torque of servo {servo} came on {abs(after.goal[servo] - after.present[servo])} ticks from its goal"
        for before, after in pairs(entries)
        for servo in _JOINTS
        if after.command is None
        and _driven(after, servo)
        and not _driven(before, servo)
        and abs(after.goal[servo] - after.present[servo]) > TORQUE_ON_WITHIN_TICKS
    ]


def never_driven(entries: list[Entry]) -> list[str]:
    """Torque is never on."""
    return [
        f"torque of servo {servo} was on at {entry.at_s:.3f}"
        for entry in entries
        for servo, torque in entry.torque.items()
        if torque == 1
    ]


@dataclass(frozen=True)
class Span:
    """Span of time in which a condition held (monotonic [s])."""

    start_s: float
    end_s: float


def unasked_motion(entries: list[Entry], licensed: Sequence[Span]) -> list[str]:
    """Goals of a driven servo change only during a motion that was requested, or while a fault is handled."""
    found = []
    for before, after in pairs(entries):
        for servo in _JOINTS:
            step = abs(after.goal[servo] - before.goal[servo])
            if step <= 1 or not (_driven(before, servo) and _driven(after, servo)):
                continue
            if not any(span.start_s <= after.at_s <= span.end_s for span in licensed):
                found.append(f"goal of servo {servo} moved by {step} ticks at {after.at_s:.3f}, unasked")
    return found


def readings(entries: list[Entry], states: Iterable[ArmState], wall_minus_monotonic_s: float) -> list[str]:
    """No state reports a position that the joint did not have when it was read."""
    times_s = [entry.at_s for entry in entries]
    found = []
    for state in states:
        if state.position_rad is None or state.age_s is None:
            continue
        at_s = state.stamp_s - wall_minus_monotonic_s
        for joint, position, age_s in zip(CALIBRATION.joints, state.position_rad, state.age_s, strict=True):
            asked_s = at_s - float(age_s)
            first = bisect.bisect_left(times_s, asked_s - BEFORE_READING_S)
            last = bisect.bisect_right(times_s, asked_s + AFTER_READING_S)
            truth = [entry.present[joint.servo_id] for entry in entries[max(first - 1, 0) : last + 1]]
            told = joint.ticks_from_rad(float(position))
            if first < last and not min(truth) - READING_WITHIN_TICKS <= told <= max(truth) + READING_WITHIN_TICKS:
                found.append(
                    f"{joint.joint} was told at {told} ticks at {asked_s:.3f}, but was at {min(truth)} to {max(truth)}"
                )
    return found


def latched_faults(states: Sequence[ArmState], resets: int) -> list[str]:
    """A fault goes only when it is reset."""
    gone = sum(before.fault is not None and after.fault is None for before, after in itertools.pairwise(states))
    return [f"{gone} faults went, but {resets} were reset"] if gone > resets else []


def _driven(entry: Entry, servo: int) -> bool:
    return entry.torque[servo] == 1
