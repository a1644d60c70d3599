"""Verification of a calibrated arm: the poses to compare with the model, and the meaning of a comparison. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robot.calibration import RAD_PER_TICK
from robot.description.model import RobotModel

LIMIT_MARGIN_RAD = 0.1  # distance from the limits, at which a calibration that is a little off meets no stop [rad]

# Distances from zero at which a joint shows its direction to the eye; the smaller ones where space is short [rad].
AMPLITUDES_RAD = (0.4, 0.25, 0.15)

BACKLASH_RAD = 0.0175  # backlash of a real arm's joint (0.9 to 1.0 deg were measured) [rad]

# Duty that an error of one tick calls for, per unit of register P_GAIN: the factory's gain of 32 stalls at 5 deg, as a
# share of full duty.
DUTY_PER_TICK_AND_GAIN = 0.0005

# Factor by which a droop may exceed what gain and load explain: load is measured in steps, and ripples.
DROOP_MARGIN = 1.5

WORTH_TELLING_RAD = 0.06  # an explained droop that is worth a sentence [rad]

FACTORY_P_GAIN = 32

# Share of the gripper's way that is open at the end: enough to tell it from closed, and off its stop.
GRIPPER_OPEN_SHARE = 0.7

Positions = Mapping[str, float]


@dataclass(frozen=True)
class VerificationPose:
    """Pose to compare: the first of the candidates that can be reached."""

    name: str
    candidates: tuple[Positions, ...]  # positions of the arm's joints, by joint [rad]


def poses(robot: RobotModel) -> tuple[VerificationPose, ...]:
    """Return the model's zero, two poses around it with every joint elsewhere, and a pose of the gripper alone."""
    joints = [robot.joints[name] for name in robot.groups[robot.default_group].joints]
    named = robot.named_states.get(robot.default_group, {})

    def within(wanted: Mapping[str, float]) -> Positions:
        inside = {}
        for joint in joints:
            middle = (joint.lower + joint.upper) / 2.0
            lower, upper = min(joint.lower + LIMIT_MARGIN_RAD, middle), max(joint.upper - LIMIT_MARGIN_RAD, middle)
            inside[joint.name] = min(max(wanted.get(joint.name, 0.0), lower), upper)
        return inside

    def around(signs: Sequence[int]) -> tuple[Positions, ...]:
        return tuple(
            within({joint.name: signs[at % len(signs)] * amplitude for at, joint in enumerate(joints)})
            for amplitude in AMPLITUDES_RAD
        )

    grippers: tuple[VerificationPose, ...] = ()
    gripper = robot.gripper
    if gripper is not None and any(set(gripper.joints) <= set(each.joints) for each in robot.groups.values()):
        wide = gripper.closed + GRIPPER_OPEN_SHARE * (gripper.open - gripper.closed)
        grippers = (VerificationPose("open gripper", (dict.fromkeys(gripper.joints, wide),)),)
    zero = within({})
    by_distance = sorted(named.values(), key=lambda state: sum(abs(state.get(joint.name, 0.0)) for joint in joints))
    others = (within(state) for state in by_distance)
    return (
        VerificationPose("zero", (zero, *(state for state in others if state != zero))),
        VerificationPose("first pose beside zero", (*around((1, -1)), *around((1, 1, -1)))),
        VerificationPose("second pose beside zero", (*around((-1, 1)), *around((-1, -1, 1)))),
        *grippers,
    )


@dataclass(frozen=True)
class Droop:
    """Distance of a joint from its goal while it holds."""

    joint: str
    droop_rad: float  # goal less position [rad]
    load: float  # share of full motor duty, signed
    p_gain: int | None = None  # register P_GAIN; None where it is not known

    @property
    def explained_rad(self) -> float:
        """Distance that backlash, and the gain at this load, explain [rad]."""
        gain = max(self.p_gain or FACTORY_P_GAIN, 1)
        return BACKLASH_RAD + abs(self.load) / (DUTY_PER_TICK_AND_GAIN * gain) * RAD_PER_TICK

    def finding(self) -> str:
        """Return the sentence on it; empty when it is as it should be."""
        droop_rad = abs(self.droop_rad)
        droop = f"{self.joint} stands {math.degrees(droop_rad):.1f} deg from its goal"
        if droop_rad > max(DROOP_MARGIN * self.explained_rad, BACKLASH_RAD + WORTH_TELLING_RAD / 2.0):
            return (
                f"{droop}, and its gain explains {math.degrees(self.explained_rad):.1f} deg of it: something blocks "
                "it, its horn slips, the supply is weak, or its angle limits end before the goal"
            )
        if droop_rad > WORTH_TELLING_RAD:
            return (
                f"{droop} under {abs(self.load):.0%} of its motor's duty: its position gain "
                f"{'' if self.p_gain is None else f'of {self.p_gain} '}lets it; more gain, or less weight, raises it"
            )
        return ""


def seen_findings(seen: Sequence[tuple[str, frozenset[str]]], ends: frozenset[str]) -> list[str]:
    """Return a sentence for each joint that looked otherwise in a pose, zero first; zeros of ``ends`` are stops."""
    findings = []
    for joint in sorted(frozenset().union(*(joints for _, joints in seen))):
        where = [name for name, joints in seen if joint in joints]
        at_zero = joint in seen[0][1]
        if joint in ends:
            remedy = "calibrate it again, from closed to open, with its direction (drive_mode)"
        elif at_zero:
            remedy = (
                "its zero is off: calibrate it again from stop to stop, or trim it by arm.zero_offset_rad, where its "
                "horn sits a tooth off"
            )
        else:
            remedy = (
                "it agrees at zero and not beside it, so it turns the other way: its horn is mounted mirrored, or its "
                "sign in robot.toml is; nothing else should move before"
            )
        findings.append(f"{joint} looks otherwise than the model in {len(where)} of {len(seen)} poses: {remedy}")
    return findings
