"""The command ``armbridge setup``: ids and settings for new servos, one at a time, and back again."""

import argparse
import contextlib
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from robot.commissioning.scan import BAUDRATES, FACTORY_ID, ServoRegisters
from robot.commissioning.setup import (
    BAUDRATE,
    NO_ANSWER,
    BackupFile,
    Change,
    SavedServo,
    ServoLine,
    changes_back,
    changes_for,
    look,
    match_saved,
    needs_writing,
    read_backup,
    search,
    supply_complaint,
    write,
)
from robot.description import robot_folder
from robot.description.servo_table import ServoSpec
from robot.errors import NoReply, PortError, StartupError
from robot.hardware.boards import resolve_port
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import check_model
from robot.hardware.feetech.profiles import PROFILES, ServoProfile, nearest_profile, profile_of
from robot.hardware.feetech.registers import Register
from server.commands.arm import relax_arm
from server.commands.options import (
    FEETECH_ONLY,
    Subparsers,
    add_arm,
    add_command,
    read_hardware,
    signals_as_ctrl_c,
    signals_wait,
)
from server.commands.terminal import ExitCode, Terminal, table
from server.errors import ConfigurationError
from server.moveit.named_states import default_path


def add_setup_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "setup",
        _set_up,
        "give new servos their ids and settings, one at a time",
        "Asks for one servo after the other, from the gripper to the base, and gives each its id, 1 Mbaud, "
        "and the settings that the arm needs. Only what differs is written, after a yes, and read back. The registers "
        "from before are saved to a file first. Break it off whenever you like: the next run goes on." + FEETECH_ONLY,
    )
    add_arm(parser)
    add = parser.add_argument
    add(
        "--profile",
        choices=tuple(PROFILES),
        help="gains and protection as the factory or as lerobot sets them (the robot's own, else whichever is nearer)",
    )
    add("--joint", action="append", metavar="NAME", help="only the servo of this joint; may be repeated")
    task = parser.add_mutually_exclusive_group()
    task.add_argument(
        "--registers", action="store_true", help="the servos have their ids: only bring their settings into order"
    )
    task.add_argument("--restore", type=Path, metavar="FILE", help="write the registers of a backup back to the servos")
    add("--backup", type=Path, metavar="FILE", help="save the registers from before here (a file named by the time)")
    add("--yes", action="store_true", help="do not ask before writing")


def _set_up(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    hardware, robot = read_hardware(options), robot_folder.resolve(options.robot).model
    joints = [servo.joint for servo in hardware.servos]
    if unknown := [name for name in options.joint or () if name not in joints]:
        raise ConfigurationError(f"--joint must be one of {', '.join(joints)}, not {unknown[0]}")
    stamp = f"{datetime.now(UTC):%Y-%m-%dT%H-%M-%S.%f}"
    backup = BackupFile(options.backup or default_path(f"registers_{stamp}", robot, os.environ), robot.name)
    line = ServoLine(lambda baudrate: Bus.open(resolve_port(options.serial), baudrate))
    visit = _Visit(line, hardware.servos, profile_of(hardware.profile), backup, options, terminal)
    with signals_as_ctrl_c(), contextlib.closing(line):
        try:
            return visit.restore(options.restore) if options.restore else visit.set_up()
        except KeyboardInterrupt:
            terminal.err("broken off: the servos keep what was written to them; run the command again to go on")
            raise
        finally:
            if not backup.empty:
                terminal.err(f"registers from before: {backup.path} (armbridge setup --restore FILE)")


@dataclass(frozen=True)
class _Work:
    joint: str
    servo: ServoRegisters
    changes: tuple[Change, ...]

    @property
    def saved(self) -> SavedServo:
        new_id = next((change.wanted for change in self.changes if change.register is Register.ID), self.servo.servo_id)
        return SavedServo(
            joint=self.joint,
            servo_id=self.servo.servo_id,
            new_id=new_id,
            baudrate=self.servo.baudrate,
            registers=dict(self.servo.registers),
        )


@dataclass
class _Visit:
    line: ServoLine
    arm: Sequence[ServoSpec]
    own_profile: ServoProfile | None
    backup: BackupFile
    options: argparse.Namespace
    terminal: Terminal
    problems: bool = False

    @property
    def chosen(self) -> list[ServoSpec]:
        return [servo for servo in self.arm if not self.options.joint or servo.joint in self.options.joint]

    def set_up(self) -> ExitCode:
        """Set the servos up: together if all have their ids, otherwise one by one."""
        self.terminal.err("looking at the servos ...")
        present = self._present()
        if self.options.registers or all(joint.servo_id in present for joint in self.arm):
            if missing := [f"{each.servo_id} ({each.joint})" for each in self.chosen if each.servo_id not in present]:
                self._complain(f"no answer from servo {', '.join(missing)}: armbridge scan looks for the cause")
            there = [(joint, present[joint.servo_id]) for joint in self.chosen if joint.servo_id in present]
            if there:
                profile = self._profile(there)
                self.terminal.err(
                    f"the servos have their ids; their settings are compared with the profile {profile.name}"
                )
                self._carry_out([self._work(joint, servo, profile) for joint, servo in there])
        else:
            self.terminal.err(
                f"New servos all have the id {FACTORY_ID}: connect one at a time. Those that got another id may stay "
                "connected."
            )
            for step, joint in enumerate(reversed(self.chosen), start=1):
                self.terminal.err(f"\nstep {step} of {len(self.chosen)}: {joint.joint}, id {joint.servo_id}")
                # Any new servo may be the one with the factory's id.
                self._set_up_one(joint, present.get(joint.servo_id) if joint.servo_id != FACTORY_ID else None)
        return self._end()

    def restore(self, file: Path) -> ExitCode:
        saved = read_backup(file)
        found = self._find({each for servo in saved for each in (servo.servo_id, servo.new_id)})
        known = match_saved(saved, [servo.servo_id for servo in found])
        work = []
        for servo in found:
            if servo.servo_id not in known:
                continue
            before = known[servo.servo_id]
            if before.servo_id != servo.servo_id and len(found) > 1:
                self.terminal.err(
                    f"servo {servo.servo_id} ({before.joint}) keeps its id and baud rate: connect it alone to restore "
                    f"its id {before.servo_id} too"
                )
            work.append(_Work(before.joint, servo, changes_back(servo, before, alone=len(found) == 1)))
        if strangers := [str(servo.servo_id) for servo in found if servo.servo_id not in known]:
            self._complain(
                f"left alone, since {file} does not tell which of its servos they are: {', '.join(strangers)}"
            )
        self._carry_out(work)
        return self._end()

    def _present(self) -> dict[int, ServoRegisters]:
        """Return the servos that answer, by id; empty when several have one id."""
        try:
            found = look(self.line, BAUDRATE, {joint.servo_id for joint in self.arm})
        except (StartupError, NoReply) as error:
            if self.options.registers:
                raise
            self.terminal.err(str(error))
            return {}
        return {servo.servo_id: servo for servo in found}

    def _find(self, ids: Collection[int]) -> list[ServoRegisters]:
        """Return the servos at the first baud rate at which any answers."""
        for baudrate in BAUDRATES:
            self.terminal.err(f"looking at {baudrate} baud ...")
            if found := look(self.line, baudrate, ids):
                return found
        raise StartupError(NO_ANSWER)

    def _set_up_one(self, joint: ServoSpec, servo: ServoRegisters | None) -> None:
        """Set up the servo of a joint, which is asked for unless it is there; until it works or is declined."""
        while True:
            try:
                if servo is None:
                    self.terminal.await_enter(f"Plug in the servo of {joint.joint}")
                    only_joint = len(self.options.joint or ()) == 1
                    servo = search(self.line, joint, self.arm, self.terminal.err, only_joint=only_joint)
                self._carry_out([self._work(joint, servo, self._profile([(joint, servo)]))])
            except (StartupError, NoReply, PortError) as error:
                self.line.close()
                self.terminal.err(str(error))
                servo = None
            else:
                return

    def _profile(self, servos: Sequence[tuple[ServoSpec, ServoRegisters]]) -> ServoProfile:
        """Return the named profile, else the arm's own, else the nearest."""
        if self.options.profile is not None:
            return PROFILES[self.options.profile]
        return self.own_profile or nearest_profile((servo.registers, joint.gripper) for joint, servo in servos)

    def _work(self, joint: ServoSpec, servo: ServoRegisters, profile: ServoProfile) -> _Work:
        check_model(servo.servo_id, joint, servo[Register.MODEL_NUMBER])
        return _Work(joint.joint, servo, changes_for(servo, joint, profile))

    def _carry_out(self, work: Sequence[_Work]) -> None:
        """Write what differs, after a yes; a backup comes first."""
        for each in work:
            if complaint := supply_complaint(each.servo):
                self._complain(complaint)
            if not needs_writing(each.servo, each.changes):
                self.terminal.err(f"{each.joint} (id {each.servo.servo_id}) is in order: nothing to write")
        pending = [each for each in work if needs_writing(each.servo, each.changes)]
        if not pending:
            return
        self.terminal.err(_differences(pending))
        if not self.options.yes and not self.terminal.confirm("The servos go limp: support the arm. Write this?"):
            self._complain(f"left as they are: {', '.join(each.joint for each in pending)}")
            return
        # Lower the torque of servos that hold an arm, so that it sinks; writing switches it off at once.
        ids = {each.servo.servo_id for each in pending if each.servo.registers[Register.TORQUE_ENABLE]}
        if holding := [joint for joint in self.arm if joint.servo_id in ids]:
            relax_arm(self.line.at(pending[0].servo.baudrate), holding, self.terminal)
        for number, each in enumerate(pending, start=1):
            self.backup.save(each.saved, datetime.now(UTC))
            # Broken off while it takes a new id or baud rate, a servo would be left unlocked.
            with signals_wait():
                after = write(self.line, each.servo, each.changes)
            which = f"{number} of {len(pending)}: " if len(pending) > 1 else ""
            names = ", ".join(change.register.name for change in each.changes)
            written = f"written and read back {names}; " if names else ""
            self.terminal.err(f"{which}{each.joint} (id {after.servo_id}): {written}EPROM locked")

    def _complain(self, text: str) -> None:
        self.problems = True
        self.terminal.err(text)

    def _end(self) -> ExitCode:
        if self.problems:
            return ExitCode.PROBLEMS
        self.terminal.err("done")
        return ExitCode.DONE


def _differences(work: Sequence[_Work]) -> str:
    rows = [
        (each.joint, each.servo.servo_id, change.register.name, change.held, change.wanted)
        for each in work
        for change in each.changes
    ]
    rows += [
        (each.joint, each.servo.servo_id, Register.LOCK.name, 0, 1)
        for each in work
        if each.servo.registers[Register.LOCK] != 1
    ]
    return table(("joint", "id", "register", "in the servo", "to write"), rows)
