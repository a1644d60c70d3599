"""Procedures of the server: calibration, with the arm's orders, the file and the new start; and verification.

A verification has three poses, each compared by a person, and measures the droop of each joint.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from planners.problem import MoveItErrorCode
from robot.arm import ORDER_TIMEOUT_S, SILENT_S, Arm
from robot.calibration import TICKS_PER_TURN, Calibration, lerobot_directories, reserved, save
from robot.commissioning.session import Act, CalibrationSession, Step, SweptRange, asked_motions
from robot.commissioning.verify import Droop, VerificationPose, poses, seen_findings
from robot.description.model import RobotModel
from robot.errors import CalibrationError, OrderRefused
from robot.messages import ArmHealth, ArmState, ChangePace, Mode, Order
from server.arm.arms import ServedArm, without_prefix
from server.arm.commissioning import Dialogue, Ended, ProcedureFailed
from server.arm.setup import Description
from server.arrival import arrival_epoch
from server.errors import RefusedError
from server.execution.goal import Goal

# Names that lerobot's ids have, and that lead to no other folder.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")

# Slower states would lose count of a joint that a hand turns across the seam.
LEAST_STATE_RATE_HZ = 10.0

WRITING_TIMEOUT_S = 5.0

# Name of the register among a joint's settings.
HOMING_OFFSET = "HOMING_OFFSET"


@dataclass(frozen=True)
class Recalibrated:
    """New calibration of the arm, with which the server starts again, and the joints' positions under it [rad]."""

    arm: str
    file: Path
    position_rad: Mapping[str, float]
    ended: Ended


def check_state_rate(rate_hz: float) -> None:
    """Check that the arm's states come often enough to follow a hand."""
    if rate_hz < LEAST_STATE_RATE_HZ:
        raise OrderRefused(
            f"arm.joint_state_rate_hz must be at least {LEAST_STATE_RATE_HZ:g} Hz to calibrate, not {rate_hz:g}: a "
            "joint that is turned quickly could not be followed"
        )


class CalibrationProcedure:
    """Calibration of the arm into a file, with True if the settings name this file."""

    def __init__(
        self,
        arm: Arm,
        served: ServedArm,
        file: tuple[Path, bool],
        end_goals: Callable[[str], None],
        start_anew: Callable[[Recalibrated], None],
    ) -> None:
        description = served.description
        self._file, self._in_use = file
        if description.calibration is None:
            raise CalibrationError(str(self._file), "", "this arm has no servos to calibrate")
        self._arm = arm
        self._served = served
        self._present: Calibration = description.calibration
        offsets_rad = served.settings.zero_offset_rad
        self._trims_rad = {served.prefix + joint: offset_rad for joint, offset_rad in offsets_rad.items()}
        self._end_goals = end_goals
        self._start_anew = start_anew
        self._offsets = {joint.servo_id: joint.homing_offset for joint in self._present.joints}
        self._swept_from: Mapping[int, int] | None = None
        self._session = CalibrationSession(description.hardware.servos, asked_motions(description.robot), recentre=True)
        self._reservation = contextlib.ExitStack()
        self._reservation.enter_context(reserved(self._file, overwrite=self._in_use))

    async def run(self, dialogue: Dialogue) -> str:
        session = self._session
        while session.step is not None:
            dialogue.progress = session.progress
            dialogue.findings = [*session.findings]
            act = await dialogue.ask(session.step, session.answer, lambda: session.step)
            if act is Act.RELAX:
                await self._relax(dialogue)
            elif act is Act.WRITE:
                await self._write(dialogue)
        if session.calibration is None:
            raise CalibrationError(str(self._file), "", "there is no result")
        if self._trims_rad:
            session.findings.append(
                f"{self._served.section}.zero_offset_rad still trims {', '.join(self._trims_rad)}, which was measured "
                "with another calibration: take it out of the settings, or measure it again"
            )
        name = "" if self._in_use else f" Name it in the settings, as {self._served.section}.calibration."
        if not self._in_use and not self._served.name:
            name = f" Name it in the settings, as arm.calibration or by --calibration {self._file}."
        result = (
            f"the calibration is in the servos and in {self._file}; the arm is relaxed, and uses it from now on. "
            f"Verify it before anything else moves.{name}"
        )
        dialogue.findings = [*session.findings]
        position_rad = self._positions_rad(session.calibration.with_zero_offsets(self._trims_rad))
        self._start_anew(
            Recalibrated(self._served.name, self._file, position_rad, Ended(result, tuple(dialogue.findings)))
        )
        return result

    def take_state(self, state: ArmState, dialogue: Dialogue) -> None:
        """Track the joints; end the procedure when they are driven, or no longer read."""
        if self._swept_from is None:
            return
        ticks = self._ticks(state)
        if ticks is None:
            dialogue.fail(f"the arm is not connected: {state.reason}")
        elif state.torque_enabled:
            dialogue.fail("the arm was switched on meanwhile")
        else:
            self._session.take(ticks)
            dialogue.ranges = self._session.ranges()
            dialogue.progress = self._session.progress

    def take_health(self, health: ArmHealth) -> None:
        """Take the homing offsets that the servos have, which may be others than those calibrated."""
        if self._swept_from is not None:
            return
        ids = {joint.joint: joint.servo_id for joint in self._present.joints}
        for joint in health.joints:
            if (offset := joint.registers.get(HOMING_OFFSET)) is not None:
                self._offsets[ids[joint.joint]] = offset

    def close(self) -> None:
        """Let others write the file."""
        self._reservation.close()

    async def _relax(self, dialogue: Dialogue) -> None:
        dialogue.tell("relaxing", "The arm is being relaxed: hold it.")
        self._end_goals("the arm is being calibrated")
        done = await dialogue.until(self._arm.order(Order.RELAX), ORDER_TIMEOUT_S + SILENT_S)
        if not done.done:
            raise ProcedureFailed(f"the arm could not be relaxed: {done.message}")
        ticks = self._ticks(self._arm.state)
        if ticks is None:
            raise ProcedureFailed(f"the arm is not connected: {self._arm.state.reason}")
        self._session.begin(ticks, self._offsets)
        self._swept_from = ticks
        dialogue.ranges = self._session.ranges()

    async def _write(self, dialogue: Dialogue) -> None:
        calibration = self._session.calibration
        dialogue.tell("writing", "The calibration is being written to the servos.")
        done = await dialogue.until(self._arm.order(Order.WRITE_CALIBRATION, calibration), ORDER_TIMEOUT_S + SILENT_S)
        if not done.done or calibration is None:
            # Some servos may have it already: write it again, and do not sweep again under other offsets.
            raise OrderRefused(
                f"some servos did not take the calibration: {done.message}. Its file was not written; calibrate again"
            )
        try:
            await asyncio.wait_for(
                asyncio.to_thread(save, without_prefix(calibration, self._served.prefix), self._file), WRITING_TIMEOUT_S
            )
        except (CalibrationError, TimeoutError) as error:
            reason = str(error) or f"it took more than {WRITING_TIMEOUT_S:g} s"
            raise ProcedureFailed(
                f"the servos have the new calibration, and {self._file} was not written: {reason}. Make room or name "
                "another calibration, and calibrate again"
            ) from error
        self._session.finish()

    def _ticks(self, state: ArmState) -> dict[int, int] | None:
        """Return the positions by servo id, as the servos tell them; None for an arm that is not read."""
        if state.position_rad is None or state.mode in (Mode.DISCONNECTED, Mode.CONNECTED):
            return None
        joints = {joint.joint: joint for joint in self._present.joints}
        each = zip(state.joint_names, state.position_rad.tolist(), strict=True)
        return {joints[name].servo_id: joints[name].ticks_from_rad(position) for name, position in each}

    def _positions_rad(self, calibration: Calibration) -> dict[str, float]:
        """Return where the joints are under a new calibration: the encoders stand where they stood."""
        ranges = {each.joint: each for each in self._session.ranges()}
        position_rad = {}
        for joint in calibration.joints:
            encoder = ranges[joint.joint].present + self._offsets[joint.servo_id]
            ticks = (encoder - joint.homing_offset) % TICKS_PER_TURN
            position_rad[joint.joint] = joint.rad_from_ticks(ticks)
        return position_rad


def calibration_file(name: str, description: Description) -> tuple[Path, bool]:
    """Return the file of a calibration of lerobot to write, and True if it is the calibration in use, named ``""``."""
    if description.hardware.kind != "feetech":
        raise CalibrationError(
            name or description.title, "", f"the arm has {description.hardware.kind} servos, and this is for Feetech's"
        )
    if not name:
        if description.calibration_file is None:
            raise CalibrationError(description.title, "", "no calibration is in use: name the one to write")
        return description.calibration_file, True
    if NAME.fullmatch(name) is None:
        raise CalibrationError(
            name[:80], "", "is no name: 1 to 64 letters, digits, - and _ are, and a letter or digit comes first"
        )
    if not description.hardware.calibrations:
        raise CalibrationError(name, "", "lerobot has no place for this arm: name a file in the settings first")
    file = lerobot_directories(description.hardware.calibrations, os.environ)[0] / f"{name}.json"
    in_use = description.calibration_file
    return file, in_use is not None and in_use.resolve() == file.resolve()


# Share of the velocity and acceleration limits: a hand can be pulled away.
SLOWLY = 0.1

# Longest motion between two poses at that speed, with its planning.
MOTION_TIMEOUT_S = 120.0

# Time for a joint to come to rest, then time of the readings that are averaged [s], on the arm's clock.
SETTLE_S = 0.7
MEASURE_S = 0.5
MEASURE_TIMEOUT_S = 30.0

MOVE, YES, NO, SEVERAL = "move", "yes", "no", "several joints"

P_GAIN = "P_GAIN"

# Ends of a goal that somebody or the arm has stopped: no other pose is tried then.
STOPPED = frozenset({MoveItErrorCode.PREEMPTED, MoveItErrorCode.CONTROL_FAILED})

# Queues a goal for joint positions [rad] at a share of the limits.
GoTo = Callable[[Mapping[str, float], float], Goal]


@dataclass
class _Readings:
    """Readings of the arm at rest, from a time of its clock on [s]."""

    from_s: float
    done: asyncio.Future[None]
    droop_rad: list[np.ndarray] = field(default_factory=list)
    load: list[np.ndarray] = field(default_factory=list)


class VerificationProcedure:
    """Verification of the arm's calibration; the zeros of some joints are given by the ``ends`` of their range."""

    def __init__(
        self,
        arm: Arm,
        robot: RobotModel,
        ends: frozenset[str],
        go_to: GoTo,
        cancel: Callable[[str, str], None],
        first_motions: FirstMotions,
    ) -> None:
        self._arm = arm
        self._first_motions = first_motions
        self._ends = ends
        self._go_to = go_to
        self._cancel = cancel
        self._poses = poses(robot)
        self._joints = tuple(dict.fromkeys(joint for pose in self._poses for joint in pose.candidates[0]))
        self._gains: dict[str, int] = {}
        self._readings: _Readings | None = None
        self._goal: Goal | None = None
        self._droops: dict[str, Droop] = {}
        self._seen: list[tuple[str, frozenset[str]]] = []

    async def run(self, dialogue: Dialogue) -> str:
        dialogue.ranges = tuple(SweptRange(joint, 0, 0, 0, 0, done=False, note="") for joint in self._joints)
        question = (
            "The arm will hold itself and move slowly to three poses, and then open its gripper. Clear its way, keep "
            "hands off, and be ready to cut its supply. Move?"
        )
        await _choice(dialogue, Step("torque", question, (MOVE,)))
        await self._enable(dialogue)
        for number, pose in enumerate(self._poses):
            dialogue.progress = number / len(self._poses)
            await self._reach(dialogue, pose)
            await self._measure(dialogue)
            await self._compare(dialogue, pose)
        dialogue.progress = 1.0
        worst = max(self._droops.values(), key=lambda each: abs(each.droop_rad))
        most_deg = float(np.degrees(abs(worst.droop_rad)))
        droop = f"the greatest distance from a goal was {most_deg:.1f} deg, of {worst.joint}"
        if not dialogue.findings:
            self._first_motions.take_verified()
            return f"the arm looks as the model in {len(self._seen)} poses; {droop}"
        return f"the arm was compared in {len(self._seen)} poses, with {len(dialogue.findings)} findings; {droop}"

    def take_state(self, state: ArmState, dialogue: Dialogue) -> None:
        """Take readings while they are wanted; end the procedure when the arm cannot hold."""
        if self._goal is not None and (state.mode is Mode.FAULT or state.position_rad is None):
            dialogue.fail(f"the arm has a fault: {state.fault or state.reason}")
        readings = self._readings
        if readings is None or state.position_rad is None or state.goal_rad is None or state.load is None:
            return
        since_s = state.clock_s - readings.from_s
        if since_s >= SETTLE_S:
            readings.droop_rad.append(state.goal_rad - state.position_rad)
            readings.load.append(state.load)
        if since_s >= SETTLE_S + MEASURE_S and not readings.done.done():
            readings.done.set_result(None)

    def take_health(self, health: ArmHealth) -> None:
        for joint in health.joints:
            if (gain := joint.registers.get(P_GAIN)) is not None:
                self._gains[joint.joint] = gain

    def close(self) -> None:
        if self._goal is not None:
            self._cancel(self._goal.goal_id, "the verification has ended")

    async def _enable(self, dialogue: Dialogue) -> None:
        if self._arm.state.torque_enabled and self._arm.state.mode is Mode.HOLDING:
            return
        dialogue.tell("enabling", "The arm begins to hold itself.")
        done = await dialogue.until(self._arm.order(Order.ENABLE, epoch=arrival_epoch()), ORDER_TIMEOUT_S + SILENT_S)
        if not done.done:
            raise ProcedureFailed(f"the arm cannot be switched on: {done.message}")

    async def _reach(self, dialogue: Dialogue, pose: VerificationPose) -> None:
        """Move to the first candidate that can be reached; a refused candidate moves nothing."""
        dialogue.tell(f"moving to {pose.name}", "The arm moves slowly: keep hands off.")
        reasons: list[str] = []
        for candidate in pose.candidates:
            try:
                self._goal = self._go_to(candidate, SLOWLY)
            except RefusedError as error:
                raise ProcedureFailed(f"{pose.name} cannot be reached: {error.failure.message}") from error
            answer = await dialogue.until(self._goal.answered, MOTION_TIMEOUT_S)
            self._goal = None
            if answer.code is MoveItErrorCode.SUCCESS:
                return
            reasons.append(answer.message)
            moved = answer.performed is not None and answer.performed.executed is not None
            if moved or answer.code in STOPPED:
                break
        raise ProcedureFailed(f"{pose.name} was not reached: {reasons[-1]}")

    async def _measure(self, dialogue: Dialogue) -> None:
        dialogue.tell("measuring", "The arm holds still, and is measured.")
        readings = _Readings(self._arm.clock_s, asyncio.get_running_loop().create_future())
        self._readings = readings
        try:
            await dialogue.until(readings.done, MEASURE_TIMEOUT_S)
        finally:
            self._readings = None
        names = self._arm.state.joint_names
        droop_rad, load = np.mean(readings.droop_rad, axis=0).tolist(), np.mean(readings.load, axis=0).tolist()
        for name, droop, share in zip(names, droop_rad, load, strict=True):
            found = Droop(name, droop, share, self._gains.get(name))
            before = self._droops.get(name)
            if name in self._joints and (before is None or abs(before.droop_rad) < abs(droop)):
                self._droops[name] = found
        dialogue.droops_rad = dict(zip(names, droop_rad, strict=True))
        self._tell_findings(dialogue)

    async def _compare(self, dialogue: Dialogue, pose: VerificationPose) -> None:
        question = "Does the arm look as the model does? Compare each joint, from the foot to the gripper."
        joints: set[str] = set()
        if await _choice(dialogue, Step(f"compare {pose.name}", question, (YES, NO))) == NO:
            which = Step(f"which joint at {pose.name}", "Which joint stands otherwise?", (*self._joints, SEVERAL))
            chosen = await _choice(dialogue, which)
            if chosen != SEVERAL:
                joints.add(chosen)
            else:
                for joint in self._joints:
                    step = Step(f"{joint} at {pose.name}", f"Does {joint} stand as in the model?", (YES, NO))
                    if await _choice(dialogue, step) == NO:
                        joints.add(joint)
        self._seen.append((pose.name, frozenset(joints)))
        self._tell_findings(dialogue)

    def _tell_findings(self, dialogue: Dialogue) -> None:
        droops = [finding for each in self._droops.values() if (finding := each.finding())]
        seen = seen_findings(self._seen, self._ends) if self._seen else []
        dialogue.findings = seen + droops


async def _choice(dialogue: Dialogue, step: Step) -> str:
    return await dialogue.ask(step, lambda answer: answer, lambda: step)


log = logging.getLogger("armbridge.commissioning")

ADVICE = (
    "this calibration is not verified yet: no joint moves faster than {share:.0%} of its velocity limit until "
    "armbridge verify, or verify on the page, has found nothing (arm.unverified_speed_limit)"
)


class FirstMotions:
    """Speed limit of an arm on servos until its calibration is verified, which an empty file named by its digest says.

    ``advice`` is a sentence for a person; empty for an arm without this limit.
    """

    def __init__(self, served: ServedArm, folder: Path) -> None:
        settings, file = served.settings, served.description.calibration_file
        self._arm = served.arm
        self._full = settings.speed_limit
        self._limit = min(settings.speed_limit, settings.unverified_speed_limit)
        self._mark: Path | None = None
        if settings.serial is not None and file is not None:
            trims = repr(sorted(settings.zero_offset_rad.items()))
            self._mark = folder / hashlib.sha256(file.read_bytes() + trims.encode()).hexdigest()
        limited = self._mark is not None and self._limit < self._full and not self._mark.exists()
        self.advice = ADVICE.format(share=self._limit) if limited else ""

    def begin(self) -> None:
        """Limit the speed, where the calibration is not verified."""
        if self.advice:
            log.warning("%s", self.advice)
            self._arm.change_pace(ChangePace(speed_limit=self._limit))

    def take_verified(self) -> None:
        """Take a verification without findings: the arm moves at its own speed limit, now and after a restart."""
        if self._mark is not None:
            try:
                self._mark.parent.mkdir(parents=True, exist_ok=True)
                self._mark.touch()
            except OSError as error:
                log.warning("the verification cannot be kept in %s: %s", self._mark.parent, error)
        # A limit that a client has chosen meanwhile stays.
        if self.advice and self._arm.state.pace.speed_limit == self._limit:
            self._arm.change_pace(ChangePace(speed_limit=self._full))
        self.advice = ""
