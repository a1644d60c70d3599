"""Verification as a procedure of the server: three poses, each compared by a person, and the droop of each joint."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from planners.problem import MoveItErrorCode
from robot.arm import ORDER_TIMEOUT_S, SILENT_S, Arm
from robot.commissioning.session import Step, SweptRange
from robot.commissioning.verify import Droop, VerificationPose, poses, seen_findings
from robot.description.model import RobotModel
from robot.messages import ArmHealth, ArmState, ChangePace, Mode, Order
from server.arm.arms import ServedArm
from server.arm.commissioning import Dialogue, ProcedureFailed
from server.arrival import arrival_epoch
from server.errors import RefusedError
from server.execution.goal import Goal, GoTo

log = logging.getLogger("armbridge.commissioning")

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
        dialogue.show("enabling", "The arm begins to hold itself.")
        done = await dialogue.until(self._arm.order(Order.ENABLE, epoch=arrival_epoch()), ORDER_TIMEOUT_S + SILENT_S)
        if not done.done:
            raise ProcedureFailed(f"the arm cannot be switched on: {done.message}")

    async def _reach(self, dialogue: Dialogue, pose: VerificationPose) -> None:
        """Move to the first candidate that can be reached; a refused candidate moves nothing."""
        dialogue.show(f"moving to {pose.name}", "The arm moves slowly: keep hands off.")
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
            if answer.performed.planned or answer.code in STOPPED:
                break
        raise ProcedureFailed(f"{pose.name} was not reached: {reasons[-1]}")

    async def _measure(self, dialogue: Dialogue) -> None:
        dialogue.show("measuring", "The arm holds still, and is measured.")
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
        self._show_findings(dialogue)

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
        self._show_findings(dialogue)

    def _show_findings(self, dialogue: Dialogue) -> None:
        droops = [finding for each in self._droops.values() if (finding := each.finding())]
        seen = seen_findings(self._seen, self._ends) if self._seen else []
        dialogue.findings = seen + droops


async def _choice(dialogue: Dialogue, step: Step) -> str:
    return await dialogue.ask(step, lambda answer: answer, lambda: step)


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
