"""Survey of the servos before anything is written to them, and the reasons not to drive them."""

import contextlib
import math
from collections.abc import Iterator, Mapping

from robot.calibration import MAX_TICK, TICKS_PER_TURN, JointCalibration
from robot.errors import NoReply, StartupError
from robot.faults import ServoAlert, ServoWarning
from robot.hardware.interface import Steps
from robot.hardware.servos.bus import ServoBus, read, read_registers
from robot.hardware.servos.family import ServoFamily, ServoFound, ServoMap, Values, label

MISSING_ADVICE = ": check the cable to the first one named and its id"

# Limits that differ from the calibration by more than this many ticks (0.7 deg) are of another calibration.
LIMITS_AGREE_WITHIN_TICKS = 8

# A servo that counts more turns was turned by another program. The SDK cannot send every goal that far away: some have
# the bytes of a packet's header (32 turns).
MOST_TURNS = 16


def survey(
    family: ServoFamily, bus: ServoBus, servos: ServoMap, *, simulated: bool = False
) -> Steps[dict[int, ServoFound]]:
    """Survey every servo by id, without writing; raises NoReply, or StartupError for a servo not to be driven."""
    models = yield from _identify(family, bus, servos, simulated=simulated)
    found = {}
    for joint in servos.joints:
        values: dict[object, int] = {}
        for block in family.survey_blocks(joint):
            values |= yield from read_registers(bus, joint.servo_id, block)
        family.check_settings(joint, values)
        found[joint.servo_id] = ServoFound(models[joint.servo_id], values, _turns_ticks(family, servos, joint, values))
    return family.compare(servos.joints, found)


def limits_warnings(
    joint: JointCalibration, alert: ServoAlert, limits_ticks: tuple[int, int]
) -> Iterator[ServoWarning]:
    """Yield the warning about a servo whose angle limits are of another calibration."""
    calibrated = joint.range_min, joint.range_max
    if max(abs(a - b) for a, b in zip(limits_ticks, calibrated, strict=True)) > LIMITS_AGREE_WITHIN_TICKS:
        limits = alert.value.replace("_", " ")
        sentence = f"the servo's {limits} {limits_ticks} differ from the calibrated range {calibrated} ticks"
        yield ServoWarning(alert, sentence)


def calibration_refusal(family: ServoFamily, servos: ServoMap) -> str:
    """Return the reason not to drive servos with another homing offset, or limits of another one; empty for none."""
    shifted = []
    for joint in servos.joints:
        held = servos.found[joint.servo_id].values[family.registers.homing_offset]
        if held != joint.homing_offset:
            angle_deg = math.degrees(abs(joint.rad_s_from_ticks_s(held - joint.homing_offset)))
            shifted.append(f"{label(joint)} by {angle_deg:.1f} deg ({held} instead of {joint.homing_offset} ticks)")
    if not shifted:
        return _limits_refusal(family, servos)
    return (
        f"the zero has shifted since the calibration at {', '.join(shifted)}: other homing offsets were written into "
        f"the servos. {family.recalibrate_advice}"
    )


def change_refusal(
    family: ServoFamily, servos: ServoMap, before: Mapping[int, ServoFound], *, offsets_known: bool
) -> str:
    """Return the reason not to drive servos whose calibration has changed while connected; none if it is known."""
    changed = []
    for joint in servos.joints:
        was, held = (_calibrated(family, each[joint.servo_id].values) for each in (before, servos.found))
        calibrated = joint.homing_offset, joint.range_min, joint.range_max
        if held != was and not (offsets_known and held == calibrated):
            changed.append(
                f"{label(joint)} (offset {was[0]} to {held[0]}, limits {was[1]}..{was[2]} to {held[1]}..{held[2]} "
                "ticks)"
            )
    if not changed:
        return ""
    return (
        f"the servos do not have the calibration in use any longer at {', '.join(changed)}. {family.recalibrate_advice}"
    )


def _limits_refusal(family: ServoFamily, servos: ServoMap) -> str:
    """Return the reason not to drive servos whose range was shifted; wider and narrower ones are another's choice."""
    shifted = []
    # Servos that count turns have limits in a mode alone in which they do not.
    for joint in () if family.counts_turns else servos.joints:
        low, high = family.position_limits_ticks(servos.found[joint.servo_id].values)
        low_by, high_by = low - joint.range_min, high - joint.range_max
        # A limit at the end of the turn is none: it was opened, not shifted.
        up = low_by > LIMITS_AGREE_WITHIN_TICKS and high_by > LIMITS_AGREE_WITHIN_TICKS and high != MAX_TICK
        down = low_by < -LIMITS_AGREE_WITHIN_TICKS and high_by < -LIMITS_AGREE_WITHIN_TICKS and low != 0
        if up or down:
            shifted.append(f"{label(joint)} {low} to {high} instead of {joint.range_min} to {joint.range_max} ticks")
    if not shifted:
        return ""
    return (
        f"the angle limits are of another zero than the homing offset at {', '.join(shifted)}: the writing of a "
        f"calibration was broken off. {family.recalibrate_advice}"
    )


def _calibrated(family: ServoFamily, values: Values) -> tuple[int, int, int]:
    return values[family.registers.homing_offset], *family.position_limits_ticks(values)


def _identify(family: ServoFamily, bus: ServoBus, servos: ServoMap, *, simulated: bool) -> Steps[dict[int, int]]:
    models: dict[int, int] = {}
    for servo in servos.ids:
        with contextlib.suppress(NoReply):
            models[servo] = yield from read(bus, servo, family.registers.model_number)
    if not models:
        raise StartupError(f"no servo answers{'' if simulated else family.none_answers_advice}")
    if missing := [servos.label(servo) for servo in servos.ids if servo not in models]:
        raise StartupError(f"no answer from {', '.join(missing)}{'' if simulated else MISSING_ADVICE}")
    for joint in servos.joints:
        family.check_model(joint, models[joint.servo_id])
    return models


def _turns_ticks(family: ServoFamily, servos: ServoMap, joint: JointCalibration, values: Values) -> int:
    if not family.counts_turns:
        return 0
    present = values[family.registers.present_position]
    turns_ticks = servos.turns_ticks(joint.servo_id, present)
    if abs(turns_ticks) > MOST_TURNS * TICKS_PER_TURN:
        raise StartupError(
            f"servo {label(joint)} is at {present} ticks, more than {MOST_TURNS} turns away from its calibrated range: "
            "switch its supply off and on"
        )
    return turns_ticks
