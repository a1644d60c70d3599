"""``armbridge calibrate``: the calibration session at a terminal, on a bus that no server uses."""

import argparse
import contextlib
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robot.calibration import Calibration, new_calibration_path, reserved, save
from robot.commissioning.scan import explain_missing, scan
from robot.commissioning.session import HOLD, WRITE, Act, CalibrationSession, Step, asked_motions
from robot.description import robot_folder
from robot.description.servo_table import ServoSpec
from robot.errors import CalibrationError, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import differences, write_to_servos
from robot.hardware.feetech.registers import TELEMETRY, Register, parse_telemetry
from robot.hardware.interface import run_to_end
from robot.hardware.servos.family import Difference
from server.commands.arm import relax_arm
from server.commands.options import (
    FEETECH_ONLY,
    Subparsers,
    add_arm,
    add_command,
    load_calibration,
    open_bus,
    read_hardware,
    signals_as_ctrl_c,
)
from server.commands.terminal import ExitCode, Terminal, chosen, prompt, table

# Fast enough to follow a hand across the seam (no joint turns by half a turn meanwhile), slow enough to be read.
SWEEP_PERIOD_S = 0.02


def add_calibrate_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "calibrate",
        _calibrate,
        "record the ranges and directions of the joints in a calibration file of lerobot's format",
        "Switches torque off, asks you to move every joint from stop to stop, asks for a motion of each "
        "joint that shows its direction, and writes a file like lerobot's. "
        "Nothing is written to the servos unless you say --write-servos." + FEETECH_ONLY,
    )
    parser.add_argument(
        "file", metavar="NAME_OR_PATH", help="where to write: a file, or an id for lerobot's calibration directory"
    )
    add_arm(parser)
    parser.add_argument(
        "--write-servos",
        action="store_true",
        help="choose homing offsets with which no joint crosses the seam of a turn, and write them and the angle "
        "limits into the servos' EPROM, where they differ",
    )
    parser.add_argument(
        "--write-back",
        action="store_true",
        help="measure nothing: write the offsets and limits of a calibration that is there into the servos",
    )
    parser.add_argument("--no-directions", action="store_true", help="do not ask for the joints' directions")
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
    parser.add_argument(
        "--yes", action="store_true", help="do not ask before torque is switched off, nor before anything is written"
    )


def _write_back(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    hardware = read_hardware(options)
    calibration = load_calibration(options.file, hardware)
    with signals_as_ctrl_c(), contextlib.closing(open_bus(options)) as bus:
        changes = differences(calibration, _all_there(bus, hardware.servos, terminal))
        if not changes:
            terminal.err("the servos hold these values already")
            return ExitCode.DONE
        terminal.err(_differences_table(changes))
        question = "Torque will be switched off, the arm sinks, and these values are written: hold it. Go on?"
        if not options.yes and not terminal.confirm(question):
            return ExitCode.FAILED
        if relax_arm(bus, hardware.servos, terminal) is not ExitCode.DONE:
            return ExitCode.FAILED
        run_to_end(write_to_servos(bus, changes))
    terminal.err("written to the servos")
    return ExitCode.DONE


def _calibrate(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    if options.write_back:
        return _write_back(options, terminal)
    hardware = read_hardware(options)
    path = new_calibration_path(options.file, hardware.calibrations, os.environ)
    reserving = reserved(path, overwrite=options.overwrite)
    with signals_as_ctrl_c(), reserving, contextlib.closing(open_bus(options)) as bus:
        registers = _all_there(bus, hardware.servos, terminal)
        offsets = {servo_id: held[Register.HOMING_OFFSET] for servo_id, held in registers.items()}
        motions = {} if options.no_directions else asked_motions(robot_folder.resolve(options.robot).model)
        session = CalibrationSession(hardware.servos, motions, recentre=options.write_servos)
        return _Conversation(session, bus, offsets, path, terminal, options.yes).run()


def _all_there(bus: Bus, servos: Sequence[ServoSpec], terminal: Terminal) -> dict[int, Mapping[Register, int]]:
    terminal.err("looking at the servos ...")
    result = scan(bus, tuple(servo.servo_id for servo in servos))
    if missing := explain_missing(result, servos):
        raise StartupError("; ".join(missing))
    return result.registers


@dataclass(frozen=True)
class _Conversation:
    session: CalibrationSession
    bus: Bus
    offsets: dict[int, int]
    path: Path
    terminal: Terminal
    yes: bool

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(servo.servo_id for servo in self.session.servos)

    def run(self) -> ExitCode:
        session, terminal = self.session, self.terminal
        while (step := session.step) is not None:
            if step.name == WRITE and session.calibration is not None:
                terminal.err(_calibration_table(session.calibration))
                for finding in session.findings:
                    terminal.err(f"* {finding}")
                if session.to_mend:
                    terminal.err(f"nothing is written: mend {', '.join(session.to_mend)}, then calibrate again")
                    return ExitCode.PROBLEMS
            try:
                act = session.answer(self._answer(step))
            except CalibrationError as error:
                if not session.ranges() or session.step is None:
                    raise
                terminal.err(str(error))
                continue
            if act is Act.RELAX:
                if relax_arm(self.bus, session.servos, terminal) is not ExitCode.DONE:
                    return ExitCode.FAILED
                ticks = {servo_id: self.bus.read(servo_id, Register.PRESENT_POSITION) for servo_id in self.ids}
                session.begin(ticks, self.offsets)
            elif act is Act.WRITE:
                self._write()
        return ExitCode.DONE

    def _answer(self, step: Step) -> str:
        """Return the answer to a step; positions are followed and shown meanwhile."""
        if self.yes and step.name in (HOLD, WRITE):
            return step.answers[0]
        self.terminal.ask(f"{step.instruction}{prompt(step.answers)}")
        while (line := self.terminal.line_typed()) is None:
            if step.name != HOLD:
                frames = self.bus.sync_read(self.ids, TELEMETRY.address, TELEMETRY.length)
                self.session.take(
                    {servo: parse_telemetry(frame.data).position_ticks for servo, frame in frames.items()}
                )
                rows = [
                    (each.joint, each.lowest, each.present, each.highest, each.note) for each in self.session.ranges()
                ]
                self.terminal.show_live(table(("joint", "lowest", "present", "highest", ""), rows))
            time.sleep(SWEEP_PERIOD_S)
        answer = chosen(line, step.answers)
        if step.name == HOLD and answer not in step.answers:
            raise CalibrationError("answer", answer, "the arm was not relaxed")
        return answer

    def _write(self) -> None:
        session, terminal = self.session, self.terminal
        calibration = session.calibration
        if calibration is None:
            raise CalibrationError(str(self.path), "", "there is no result")
        changes = differences(calibration, scan(self.bus, self.ids).registers)
        if session.recentre and changes:
            terminal.err("writing to the servos:")
            terminal.err(_differences_table(changes))
            run_to_end(write_to_servos(self.bus, changes))
        elif session.recentre:
            terminal.err("the servos hold these values already")
        elif changes:
            terminal.err("the servos' angle limits stay as they are (--write-servos would change them):")
            terminal.err(_differences_table(changes))
        save(calibration, self.path)
        session.finish()
        terminal.out(_calibration_table(calibration))
        terminal.err(f"written to {self.path}; armbridge verify has a running server compare the arm with it")


def _calibration_table(calibration: Calibration) -> str:
    rows = [
        (joint.joint, joint.servo_id, joint.homing_offset, joint.range_min, joint.range_max, joint.drive_mode)
        for joint in calibration.joints
    ]
    return table(("joint", "id", "homing_offset", "range_min", "range_max", "drive_mode"), rows)


def _differences_table(changes: Sequence[Difference]) -> str:
    rows = [(each.joint, each.register.name, each.in_servo, each.calibrated) for each in changes]
    return table(("joint", "register", "in the servo", "calibrated"), rows)
