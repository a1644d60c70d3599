"""Experiments on Feetech servos: each asks for a property that no document states.

    python examples/servo_experiments.py --serial auto

Each is carried out after your yes (``--yes`` agrees to all but the last, which needs your hands). An experiment that
switches torque uses one servo (:class:`ServoRig`), at a fifth of its torque, within 25 ticks (2 deg) of its position,
only if it is relaxed, and leaves it relaxed. Nothing that is written outlives a power cut. The arm process works with
any result, since it reads back what it relies on.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from robot.commissioning.doctor import Finding, Verdict
from robot.errors import NoReply, RobotError, StartupError
from robot.hardware.boards import resolve_port
from robot.hardware.feetech.bus import SERVO_IDS, Bus
from robot.hardware.feetech.family import Feetech
from robot.hardware.feetech.registers import (
    GOAL_ADDRESS,
    TELEMETRY,
    Register,
    Telemetry,
    parse_telemetry,
)
from robot.hardware.interface import StatusFlag, run_to_end
from robot.hardware.servos.bus import ATTEMPTS, write_verified

GENTLE_TORQUE = 200  # Register TORQUE_LIMIT during experiments [0.1 %]: a finger stops the gripper

# A step that shows in the readings and is harmless; torque does not come on further than this from the goal.
STEP_TICKS = 25
STEP_TICKS_S = 300
STEP_S = 0.4

FOLLOWED_TICKS = STEP_TICKS // 2  # a servo that has come this far of a step has followed it
RISE_SHARE = 0.63  # share of a step that is done after one time constant

# Register RETURN_DELAY: lerobot's comment names 250 (500 us) as the factory's value.
LONG_RETURN_DELAY = 250
RETURN_DELAY_READS = 30
RETURN_DELAY_SEEN_S = 0.0003

DAMPING = 2  # value of TORQUE_ENABLE that one vendor's document calls damping
CURRENT_SEEN_A = 0.02  # smaller currents are noise of the measurement [A]

# Time for a person to cut the power, and to restore it.
POWER_TIMEOUT_S = 60.0
POWER_POLL_S = 0.1

BOOT_S = 0.5  # time for a servo to boot


class Undecided(RobotError):  # noqa: N818 - named by the fact
    """Experiment that could not decide its question."""


class Answer(NamedTuple):
    """Answer of an experiment: a sentence, and a remedy where the property is a nuisance."""

    says: str
    remedy: str = ""


@dataclass(frozen=True)
class Experiment:
    """Experiment on a property of the servos."""

    name: str
    does: str  # its effects on the arm, for the person who must agree
    run: Callable[[ServoRig], Answer]  # carries it out; raises Undecided, NoReply or StartupError when it has no answer
    switches_torque: bool = False
    needs_hands: bool = False


def run_experiment(experiment: Experiment, rig: ServoRig) -> Finding:
    """Carry out an experiment; its question stays open when it has no answer."""
    try:
        answer = experiment.run(rig)
    except (Undecided, NoReply, StartupError) as error:
        return Finding(experiment.name, Verdict.OPEN, str(error))
    return Finding(experiment.name, Verdict.NOTE if answer.remedy else Verdict.GOOD, *answer)


@dataclass(frozen=True)
class ServoRig:
    """Servo under test, with guarded access to its torque; every method raises NoReply, StartupError or PortLost."""

    bus: Bus
    servo_id: int  # servo whose torque may be switched
    present_ids: tuple[int, ...]  # all servos that answer
    clock: Callable[[], float] = time.monotonic
    wait: Callable[[float], None] = time.sleep

    def read(self, register: Register) -> int:
        """Read a register of the servo."""
        return self.bus.read(self.servo_id, register)

    def telemetry(self) -> Telemetry:
        """Read the servo's telemetry; raises NoReply."""
        for _ in range(ATTEMPTS):
            if frame := self.bus.sync_read((self.servo_id,), TELEMETRY.address, TELEMETRY.length).get(self.servo_id):
                return parse_telemetry(frame.data)
        raise NoReply(self.servo_id, ATTEMPTS)

    def set(self, register: Register, value: int) -> None:
        """Write a register of the servo, and verify it."""
        run_to_end(write_verified(self.bus, self.servo_id, register, value), self.wait)

    def set_goal(self, goal_ticks: int) -> None:
        """Set the servo's goal, to be approached slowly, and verify it."""
        head, tail = Feetech().around_goal(STEP_TICKS_S)
        self.bus.sync_write(GOAL_ADDRESS, {self.servo_id: head + Register.GOAL_POSITION.encode(goal_ticks) + tail})
        self.set(Register.GOAL_POSITION, goal_ticks)

    def require_relaxed(self) -> None:
        """Raise StartupError for a servo that holds; relax an overloaded servo."""
        if self.read(Register.STATUS) & StatusFlag.OVERLOAD:
            self.set(Register.TORQUE_ENABLE, 0)
        elif self.read(Register.TORQUE_ENABLE):
            raise StartupError(f"servo {self.servo_id} holds: relax the arm first (armbridge relax)")

    @contextlib.contextmanager
    def holding(self, goal_ticks: int | None = None) -> Iterator[int]:
        """Hold the position, or a goal STEP_TICKS away at most, with little torque; yield the goal, then relax."""
        self.require_relaxed()
        torque_limit = self.read(Register.TORQUE_LIMIT)
        start = self._start()
        goal = start if goal_ticks is None else goal_ticks
        if abs(goal - start) > STEP_TICKS:
            raise StartupError(f"servo {self.servo_id} was moved from {goal} to {start} ticks meanwhile")
        try:
            self.set(Register.TORQUE_LIMIT, GENTLE_TORQUE)
            self.set_goal(goal)
            self.set(Register.TORQUE_ENABLE, 1)
            yield goal
        finally:
            self.set(Register.TORQUE_ENABLE, 0)
            self.set(Register.TORQUE_LIMIT, torque_limit)

    def one_step_from(self, ticks: int) -> int:
        """Return a goal that is STEP_TICKS away, towards the middle of the servo's range."""
        middle = (self.read(Register.MIN_ANGLE_LIMIT) + self.read(Register.MAX_ANGLE_LIMIT)) // 2
        return ticks + (STEP_TICKS if ticks < middle else -STEP_TICKS)

    def go(self, goal_ticks: int) -> list[tuple[float, Telemetry]]:
        """Go to a goal; return the telemetry on the way, with the time since the goal was set [s]."""
        self.set_goal(goal_ticks)
        start_s = self.clock()
        samples: list[tuple[float, Telemetry]] = []
        while (at_s := self.clock() - start_s) < STEP_S or not samples:
            samples.append((at_s, self.telemetry()))
        return samples

    def await_answers(self, *, answering: bool) -> bool:
        """Wait until the servo answers, or until it does not; return False after :data:`POWER_TIMEOUT_S`."""
        until_s = self.clock() + POWER_TIMEOUT_S
        while self.clock() < until_s:
            if self._answers() is answering:
                return True
            self.wait(POWER_POLL_S)
        return False

    def _start(self) -> int:
        start = self.telemetry().position_ticks
        lowest, highest = self.read(Register.MIN_ANGLE_LIMIT), self.read(Register.MAX_ANGLE_LIMIT)
        if not lowest <= start <= highest:
            raise StartupError(
                f"servo {self.servo_id} stands at {start} ticks, outside its angle limits {lowest} to {highest}"
            )
        return start

    def _answers(self) -> bool:
        with contextlib.suppress(NoReply):
            self.read(Register.TORQUE_ENABLE)
            return True
        return False


def _behind_missing(rig: ServoRig) -> Answer:
    missing = next(servo_id for servo_id in reversed(SERVO_IDS) if servo_id not in rig.present_ids)
    asked = (rig.present_ids[0], missing, *rig.present_ids[1:])
    frames = rig.bus.sync_read(asked, TELEMETRY.address, TELEMETRY.length)
    silent = [str(servo_id) for servo_id in rig.present_ids if servo_id not in frames]
    if not silent:
        return Answer("those behind it answer")
    says = f"servos {', '.join(silent)} did not answer behind the missing one"
    return Answer(says, "One servo that falls silent ends motions of the whole arm.")


def _return_delay(rig: ServoRig) -> Answer:
    before = rig.read(Register.RETURN_DELAY)
    # With LOCK 1 the value acts, and is gone with the next power cut.
    rig.set(Register.LOCK, 1)
    # Turn by turn, and the quickest of each: a busy machine makes replies late, never early.
    times: dict[int, list[float]] = {0: [], LONG_RETURN_DELAY: []}
    try:
        for _ in range(RETURN_DELAY_READS):
            for delay, taken_s in times.items():
                rig.set(Register.RETURN_DELAY, delay)
                start_s = rig.clock()
                if rig.bus.sync_read((rig.servo_id,), TELEMETRY.address, TELEMETRY.length):
                    taken_s.append(rig.clock() - start_s)
    finally:
        rig.set(Register.RETURN_DELAY, before)
    if not all(times.values()):
        raise Undecided("too many replies were lost")
    added_s = min(times[LONG_RETURN_DELAY]) - min(times[0])
    effect = "works" if added_s > RETURN_DELAY_SEEN_S else "does nothing"
    return Answer(f"{LONG_RETURN_DELAY} makes replies {added_s * 1e6:.0f} us later: it {effect}")


def _overload(rig: ServoRig) -> Answer:
    overloaded = [i for i in rig.present_ids if rig.bus.read(i, Register.STATUS) & StatusFlag.OVERLOAD]
    if not overloaded:
        raise Undecided("no servo is overloaded; run this again when one is")
    servo = replace(rig, servo_id=overloaded[0])
    with servo.holding():
        rig.wait(STEP_S)
        still = servo.read(Register.STATUS) & StatusFlag.OVERLOAD
    return (
        Answer("it does not", "Switch the servos' supply off and on after an overload.") if still else Answer("it does")
    )


def _goal_register(rig: ServoRig) -> Answer:
    with rig.holding() as start:
        goal = rig.one_step_from(start)
        rig.set_goal(goal)
        rig.wait(STEP_S)
    kept = rig.read(Register.GOAL_POSITION)
    here = rig.telemetry().position_ticks
    with rig.holding(here + start - goal) as stale:
        rig.wait(STEP_S)
        moved = rig.telemetry().position_ticks - here
        held = rig.read(Register.GOAL_POSITION)
    says = "torque off keeps the goal" if kept == goal else f"torque off changes the goal from {goal} to {kept}"
    if abs(moved) >= FOLLOWED_TICKS:
        return Answer(f"{says}; torque on drives to a goal set before: it must be set to the present position first")
    if held != stale:
        return Answer(f"{says}; torque on changes a goal set before from {stale} to {held}")
    return Answer(f"{says}; torque on does not drive to a goal set before")


def _damping(rig: ServoRig) -> Answer:
    rig.require_relaxed()
    try:
        rig.bus.write(rig.servo_id, Register.TORQUE_ENABLE, DAMPING)
        held = rig.read(Register.TORQUE_ENABLE)
    finally:
        rig.set(Register.TORQUE_ENABLE, 0)
    taken = "takes" if held == DAMPING else f"does not take (it reads back {held})"
    return Answer(f"the servo {taken} the value 2")


def _current_sign(rig: ServoRig) -> Answer:
    with rig.holding() as start:
        runs = [rig.go(target) for target in (rig.one_step_from(start), start)]
    peaks = [max((sample.current_a for _, sample in samples), key=abs) for samples in runs]
    says = f"peaks of {peaks[0]:+.3f} A and {peaks[1]:+.3f} A in opposite directions"
    if min(abs(peak) for peak in peaks) < CURRENT_SEEN_A:
        raise Undecided(f"{says}: too little to tell")
    return Answer(f"{says}: the register is {'signed' if peaks[0] * peaks[1] < 0 else 'unsigned'}")


def _lag(rig: ServoRig) -> Answer:
    gain = rig.read(Register.P_GAIN)
    with rig.holding() as start:
        goal = rig.one_step_from(start)
        samples = rig.go(goal)
    shares = [(at_s, (sample.position_ticks - start) / (goal - start)) for at_s, sample in samples]
    reached = [at_s for at_s, share in shares if share >= RISE_SHARE]
    if not reached:
        raise Undecided(f"the servo did {max(share for _, share in shares):.0%} of a step in {STEP_S} s")
    return Answer(f"a step of {STEP_TICKS} ticks is followed within {reached[0] * 1e3:.0f} ms (P gain {gain})")


def _power_up(rig: ServoRig) -> Answer:
    if not rig.await_answers(answering=False):
        raise Undecided(f"the power was not cut within {POWER_TIMEOUT_S:.0f} s")
    if not rig.await_answers(answering=True):
        raise Undecided(f"the servo did not come back within {POWER_TIMEOUT_S:.0f} s")
    rig.wait(BOOT_S)
    holding = [str(i) for i in rig.present_ids if rig.bus.read(i, Register.TORQUE_ENABLE)]
    if holding:
        says = f"servos {', '.join(holding)} power up with torque on"
        return Answer(says, "Keep clear when switching the supply on.")
    return Answer("off")


EXPERIMENTS = (
    Experiment("sync read past a missing servo", "reads only", _behind_missing),
    Experiment(
        "return delay register",
        "changes how long one servo waits before it replies, for a moment; not stored",
        _return_delay,
    ),
    Experiment(
        "overload cleared by torque off and on",
        "switches an overloaded servo, if there is one, off, on where it is, and off: hold the arm",
        _overload,
        switches_torque=True,
    ),
    Experiment(
        "goal register and torque",
        "moves the servo by 2 degrees at a fifth of its torque",
        _goal_register,
        switches_torque=True,
    ),
    Experiment("damping (torque 2)", "writes 2 to the servo's torque register, then 0", _damping, switches_torque=True),
    Experiment(
        "sign of the current",
        "moves the servo by 2 degrees and back at a fifth of its torque",
        _current_sign,
        switches_torque=True,
    ),
    Experiment(
        "lag of the position loop", "moves the servo by 2 degrees at a fifth of its torque", _lag, switches_torque=True
    ),
    Experiment(
        "torque at power-up",
        "wants you to hold the arm, switch the servos' supply off, wait two seconds, and switch it on",
        _power_up,
        needs_hands=True,
    ),
)


def agreed(experiment: Experiment, rig: ServoRig, *, yes: bool) -> bool:
    """Ask the person at the arm; return True for a yes."""
    if yes:
        return not experiment.needs_hands
    driven = f" (servo {rig.servo_id})" if experiment.switches_torque else ""
    return input(f"{experiment.name}: {experiment.does}{driven}. Go on? [y/N] ").strip().lower() in ("y", "yes")


def main() -> None:
    """Carry out the experiments on an arm, and print what each has found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--serial", default="auto", help="serial device, socket://host:port, USB id or auto (auto)")
    parser.add_argument("--servo", type=int, metavar="ID", help="servo that may be driven (the last, the gripper)")
    parser.add_argument("--yes", action="store_true", help="agree to every experiment that needs no hands")
    options = parser.parse_args()
    try:
        with contextlib.closing(Bus.open(resolve_port(options.serial))) as bus:
            present = tuple(bus.broadcast_ping())
            driven = max(present, default=None) if options.servo is None else options.servo
            if driven not in present:
                parser.exit(1, f"servo {driven} does not answer; there are {', '.join(map(str, present)) or 'none'}\n")
            rig = ServoRig(bus, driven, present)
            for experiment in EXPERIMENTS:
                if agreed(experiment, rig, yes=options.yes):
                    finding = run_experiment(experiment, rig)
                    print(f"{finding.check}: {finding.says}. {finding.remedy}".strip())
    except RobotError as error:
        parser.exit(1, f"{error}\n")


if __name__ == "__main__":
    main()
