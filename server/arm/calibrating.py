"""Calibration as a procedure of the server: the session's questions, the arm's orders, the file, and the new start."""

import asyncio
import contextlib
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from robot.arm import ORDER_TIMEOUT_S, SILENT_S, Arm
from robot.calibration import TICKS_PER_TURN, Calibration, lerobot_directories, reserved, save
from robot.commissioning.session import Act, CalibrationSession, asked_motions
from robot.errors import CalibrationError, OrderRefused
from robot.messages import ArmHealth, ArmState, Mode, Order
from server.arm.arms import ServedArm, without_prefix
from server.arm.commissioning import Dialogue, Ended, ProcedureFailed
from server.arm.setup import Description

# Names that lerobot's ids have, and that lead to no other folder.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")

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
    left: Mapping[str, ArmState] = field(default_factory=dict)  # states in which the server leaves its arms, by name


class CalibrationProcedure:
    """Calibration of the arm into a file, with True if the settings name this file."""

    def __init__(
        self,
        arm: Arm,
        served: ServedArm,
        file: tuple[Path, bool],
        end_goals: Callable[[str], None],
        start_again: Callable[[Recalibrated], None],
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
        self._start_again = start_again
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
        option = "" if self._served.name else f" or by --calibration {self._file}"
        name = "" if self._in_use else f" Name it in the settings, as {self._served.section}.calibration{option}."
        result = (
            f"the calibration is in the servos and in {self._file}; the arm is relaxed, and uses it from now on. "
            f"Verify it before anything else moves.{name}"
        )
        dialogue.findings = [*session.findings]
        position_rad = self._positions_rad(session.calibration.with_zero_offsets(self._trims_rad))
        self._start_again(
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
        dialogue.show("relaxing", "The arm is being relaxed: hold it.")
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
        dialogue.show("writing", "The calibration is being written to the servos.")
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
