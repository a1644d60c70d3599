"""Examination of an arm: findings with a remedy each, from registers and measured times, and experiments on its servos.

An experiment asks for a property that no document states. One that switches torque uses one servo (:class:`ServoRig`),
at a fifth of its torque, within 25 ticks (2 deg) of its position, only if it is relaxed, and leaves it relaxed. Nothing
that is written outlives a power cut. The arm process works with any result, since it reads back what it relies on.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from robot.advice import Complaint, advise
from robot.calibration import Calibration
from robot.commissioning.calibrate import differences
from robot.commissioning.scan import ScanResult, ServoReport, explain_missing, read_telemetry
from robot.commissioning.timing import CycleTimes, measure_reads
from robot.description.servo_table import ServoSpec
from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import SERVO_IDS, Bus
from robot.hardware.feetech.family import PHASE_MULTI_TURN, POSITION_MODE
from robot.hardware.feetech.registers import (
    GOAL_ADDRESS,
    MODELS,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    Telemetry,
    goal_block,
)
from robot.hardware.interface import StatusFlag, run_to_end, status_names
from robot.hardware.servos.bus import write_verified

# Temperatures of the motor's housing [degC] at which the arm process, by default, stops the arm and warns.
HOT_C = 65
WARM_C = 55

# Below this an STS3215 loses torque and reboots under load; the usual supply gives 5 V.
LOW_VOLTAGE_V = 4.5

# A drop along the chain of more than this, without load, is contact resistance.
VOLTAGE_DROP_V = 0.4

# A cycle has 10 ms; with the write (0.6 ms) and a retry in reserve the read may take half of it.
LONGEST_ROUND_TRIP_S = 0.005

# 2.0 ms are usual. Above this some timer in between waits, such as the latency timer of an FTDI chip.
USUAL_ROUND_TRIP_S = 0.0035

# Single packets get lost on a good arm; one in a hundred is a bad cable.
USUAL_LOST_SHARE = 0.01

# A loop that starts later than this in one of a hundred cycles makes motions rough.
USUAL_LATENESS_S = 0.004

# Unit of register RETURN_DELAY [us].
RETURN_DELAY_US = 2


class Verdict(Enum):
    """Severity of a finding."""

    GOOD = "good"
    NOTE = "note"
    PROBLEM = "problem"
    OPEN = "open"  # not checked, or undecided


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        check: name of the check.
        verdict: severity.
        says: observation, a sentence or figures.
        remedy: advice to the person at the arm; empty for none.
    """

    check: str
    verdict: Verdict
    says: str
    remedy: str = ""


def judge_scan(result: ScanResult, joints: Sequence[ServoSpec], calibration: Calibration | None) -> list[Finding]:
    """Judge the result of a scan.

    Args:
        result: result of the scan.
        joints: servos of the arm.
        calibration: calibration of the arm; None if it is not known.
    """
    findings = [_servos(result, joints)]
    if result.servos:
        servos = result.servos
        findings += [
            _kind(servos),
            _firmware(servos),
            _voltage(servos),
            _temperature(servos),
            _status(servos),
            _phase(servos),
            _return_delay(servos),
            _calibration(servos, calibration),
        ]
    return findings


def judge_cycles(times: CycleTimes) -> list[Finding]:
    """Judge the timing of bus and machine."""
    return [_round_trip(times), _losses(times), _punctuality(times)]


def judge_long_reads(address: int, length: int, silent_ids: Sequence[int]) -> Finding:
    """Judge the replies to reads past the documented registers, whose lengths distinguish replies.

    Args:
        address: first register of the read.
        length: bytes of the read.
        silent_ids: servos that did not reply to it.
    """
    block = f"registers {address} to {address + length - 1}"
    if not silent_ids:
        return Finding("long reads", Verdict.GOOD, f"all servos answer a read of {block}")
    return Finding(
        "long reads",
        Verdict.PROBLEM,
        f"servos {_list(silent_ids)} do not answer a read of {block}",
        "Report their firmware: the driver asks for bytes past register 70 so that a late reply is recognised.",
    )


def _servos(result: ScanResult, joints: Sequence[ServoSpec]) -> Finding:
    problems = explain_missing(result, joints)
    if problems:
        return Finding("servos", Verdict.PROBLEM, "; ".join(problems), "See docs/hardware.md, By symptom.")
    return Finding("servos", Verdict.GOOD, f"servos {_list(sorted(result.ids))} answer")


def _kind(servos: Sequence[ServoReport]) -> Finding:
    wrong = [
        f"servo {servo.servo_id} is model {servo.model} in mode {servo.mode}"
        for servo in servos
        if servo.model not in MODELS.values() or servo.mode != POSITION_MODE
    ]
    if wrong:
        known = " and ".join(f"{name.upper()} ({number})" for name, number in MODELS.items())
        remedy = (
            f"The driver takes {known} in position mode ({POSITION_MODE}): armbridge setup --registers sets the mode; "
            'name a clone in robot.toml, model = "NUMBER".'
        )
        return Finding("model and mode", Verdict.PROBLEM, "; ".join(wrong), remedy)
    return Finding("model and mode", Verdict.GOOD, "all are known models in position mode")


def _firmware(servos: Sequence[ServoReport]) -> Finding:
    versions = {f"{servo.firmware[0]}.{servo.firmware[1]}" for servo in servos}
    if len(versions) > 1:
        listed = ", ".join(f"{servo.servo_id}: {servo.firmware[0]}.{servo.firmware[1]}" for servo in servos)
        remedy = "Bring all to the same version with Feetech's FD program; lerobot refuses a mixture."
        return Finding("firmware", Verdict.NOTE, f"versions differ ({listed})", remedy)
    return Finding("firmware", Verdict.GOOD, f"all have {versions.pop()}")


def _voltage(servos: Sequence[ServoReport]) -> Finding:
    volts = {servo.servo_id: servo.telemetry.voltage_v for servo in servos}
    lowest, highest = min(volts.values()), max(volts.values())
    says = f"{lowest:.1f} to {highest:.1f} V"
    too_high = [servo.servo_id for servo in servos if volts[servo.servo_id] > servo.max_voltage_v]
    if too_high:
        remedy = "Switch it off: this is a 7.4 V servo on a 12 V supply, or register 14 (Max_Voltage) is set wrongly."
        return Finding("voltage", Verdict.PROBLEM, f"{says}, too much for servos {_list(too_high)}", remedy)
    if lowest < LOW_VOLTAGE_V:
        return Finding("voltage", Verdict.PROBLEM, says, "Use a supply of 5 V and 4 A or more, with short thick leads.")
    if highest - lowest > VOLTAGE_DROP_V:
        return Finding("voltage", Verdict.NOTE, f"{says} along the chain", "Look for a plug with bad contact.")
    return Finding("voltage", Verdict.GOOD, says)


def _temperature(servos: Sequence[ServoReport]) -> Finding:
    hottest = max(servos, key=lambda servo: servo.telemetry.temperature_c)
    degrees = hottest.telemetry.temperature_c
    says = f"the hottest is servo {hottest.servo_id} with {degrees} degrees"
    if degrees >= WARM_C:
        verdict = Verdict.PROBLEM if degrees >= HOT_C else Verdict.NOTE
        return Finding("temperature", verdict, says, "Relax the arm and let it cool; do not hold it stretched out.")
    return Finding("temperature", Verdict.GOOD, says)


def _status(servos: Sequence[ServoReport]) -> Finding:
    flags = {servo.servo_id: status_names(servo.telemetry.status) for servo in servos if servo.telemetry.status}
    if flags:
        problems = [f"servo {servo_id}: {', '.join(names)}" for servo_id, names in flags.items()]
        remedy = " ".join(advise(Complaint(name) for names in flags.values() for name in names))
        return Finding("error bits", Verdict.PROBLEM, "; ".join(problems), remedy)
    return Finding("error bits", Verdict.GOOD, "no servo complains")


def _phase(servos: Sequence[ServoReport]) -> Finding:
    counting = [servo.servo_id for servo in servos if servo.phase & PHASE_MULTI_TURN]
    if counting:
        remedy = "Clear bit 4 (value 16) of register 18 with Feetech's FD program, or connect lerobot once: it does."
        says = f"servos {_list(counting)} count several turns, so their position may overflow"
        return Finding("phase bit 4", Verdict.PROBLEM, says, remedy)
    return Finding("phase bit 4", Verdict.GOOD, "positions stay within one turn")


def _return_delay(servos: Sequence[ServoReport]) -> Finding:
    delayed = {servo.servo_id: servo.return_delay * RETURN_DELAY_US for servo in servos if servo.return_delay}
    if delayed:
        says = ", ".join(f"servo {servo_id}: {delay} us" for servo_id, delay in delayed.items())
        remedy = "If the round trip is long, set register 7 (Return_Delay) to 0; lerobot does when it connects."
        return Finding("return delay", Verdict.NOTE, says, remedy)
    return Finding("return delay", Verdict.GOOD, "0")


def _calibration(servos: Sequence[ServoReport], calibration: Calibration | None) -> Finding:
    if calibration is None:
        return Finding("calibration", Verdict.OPEN, "not compared", "Name it: --calibration NAME_OR_PATH.")
    found = differences(calibration, servos)
    if found:
        listed = ", ".join(
            f"{each.joint} {each.register.name} {each.in_servo} instead of {each.calibrated}" for each in found
        )
        remedy = "Was another arm's file named? Else calibrate anew: armbridge calibrate --write-servos."
        return Finding("calibration", Verdict.PROBLEM, f"the servos hold {listed}", remedy)
    if warnings := calibration.warnings():
        return Finding("calibration", Verdict.NOTE, "; ".join(warnings), "Calibrate anew.")
    return Finding("calibration", Verdict.GOOD, "the servos hold what the file says")


def _round_trip(times: CycleTimes) -> Finding:
    says = f"p50 {times.round_trip_p50_s * 1e3:.2f} ms, p99 {times.round_trip_p99_s * 1e3:.2f} ms"
    if not times.round_trip_p99_s <= LONGEST_ROUND_TRIP_S:
        remedy = "Connect the adapter to the machine itself, without hub or network; see docs/hardware.md."
        return Finding("round trip", Verdict.PROBLEM, says, remedy)
    if times.round_trip_p50_s > USUAL_ROUND_TRIP_S:
        remedy = "Set the adapter's latency timer to 1 ms; set the servos' return delay (register 7) to 0."
        return Finding("round trip", Verdict.NOTE, says, remedy)
    return Finding("round trip", Verdict.GOOD, says)


def _losses(times: CycleTimes) -> Finding:
    says = f"{times.lost_replies} of {times.expected_replies} replies lost"
    if times.lost_replies > USUAL_LOST_SHARE * times.expected_replies:
        remedy = "Replace cables and plugs one by one; keep them away from the supply's leads."
        return Finding("lost replies", Verdict.PROBLEM, says, remedy)
    return Finding("lost replies", Verdict.GOOD, says)


def _punctuality(times: CycleTimes) -> Finding:
    says = f"cycles start at most {times.lateness_p99_s * 1e3:.2f} ms late (p99)"
    if times.lateness_p99_s > USUAL_LATENESS_S:
        remedy = "Leave the machine less to do, or allow real-time priority (docs/hardware.md)."
        return Finding("jitter", Verdict.NOTE, says, remedy)
    return Finding("jitter", Verdict.GOOD, says)


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(str(number) for number in numbers)


# Register TORQUE_LIMIT during experiments [0.1 %]: a finger stops the gripper.
GENTLE_TORQUE = 200

# A step that shows in the readings and is harmless; torque does not come on further than this from the goal.
STEP_TICKS = 25
STEP_TICKS_S = 300
STEP_S = 0.4

# A servo that has come this far of a step has followed it.
FOLLOWED_TICKS = STEP_TICKS // 2

# Share of a step that is done after one time constant.
RISE_SHARE = 0.63

# Register RETURN_DELAY: lerobot's comment names 250 (500 us) as the factory's value.
LONG_RETURN_DELAY = 250
RETURN_DELAY_READS = 30
RETURN_DELAY_SEEN_S = 0.0003

# Value of TORQUE_ENABLE that one vendor's document calls damping.
DAMPING = 2

# Smaller currents are noise of the measurement [A].
CURRENT_SEEN_A = 0.02

# Time for a person to cut the power, and to restore it.
POWER_TIMEOUT_S = 60.0
POWER_POLL_S = 0.1

# Time for a servo to boot.
BOOT_S = 0.5


@dataclass(frozen=True)
class Experiment:
    """Experiment on a property of the servos.

    Attributes:
        name: name in the report.
        does: its effects on the arm, for the person who must agree.
        switches_torque: True if it drives a servo.
        needs_hands: True if a person must take part.
        run: carries it out; raises NoReply, StartupError or PortLost when the servo does not respond as required.
    """

    name: str
    does: str
    switches_torque: bool
    needs_hands: bool
    run: Callable[[ServoRig], Finding]


def run_experiment(experiment: Experiment, rig: ServoRig) -> Finding:
    """Carry out an experiment; it remains open when the servo does not respond as required.

    Raises:
        PortLost: the port is gone.
    """
    try:
        return experiment.run(rig)
    except (NoReply, StartupError) as error:
        return _open(experiment.name, str(error))


@dataclass(frozen=True)
class ServoRig:
    """Servo under test, with guarded access to its torque.

    Every method raises NoReply, StartupError or PortLost when the servo does not reply or take a value.

    Attributes:
        bus: an open bus.
        servo_id: servo whose torque may be switched.
        present_ids: all servos that answer.
        clock: monotonic time [s].
        wait: waits for a time [s].
    """

    bus: Bus
    servo_id: int
    present_ids: tuple[int, ...]
    clock: Callable[[], float] = time.monotonic
    wait: Callable[[float], None] = time.sleep

    def read(self, register: Register) -> int:
        """Read a register of the servo."""
        return self.bus.read(self.servo_id, register)

    def telemetry(self) -> Telemetry:
        """Read the servo's telemetry."""
        return read_telemetry(self.bus, self.servo_id)

    def set(self, register: Register, value: int) -> None:
        """Write a register of the servo, and verify it."""
        run_to_end(write_verified(self.bus, self.servo_id, register, value), self.wait)

    def set_goal(self, goal_ticks: int) -> None:
        """Set the servo's goal, to be approached slowly, and verify it."""
        self.bus.sync_write(GOAL_ADDRESS, {self.servo_id: goal_block(goal_ticks, STEP_TICKS_S)})
        self.set(Register.GOAL_POSITION, goal_ticks)

    def require_relaxed(self) -> None:
        """Raise StartupError for a servo that holds; relax one that is overloaded."""
        if self.read(Register.STATUS) & StatusFlag.OVERLOAD:
            self.set(Register.TORQUE_ENABLE, 0)
        elif self.read(Register.TORQUE_ENABLE):
            raise StartupError(f"servo {self.servo_id} holds: relax the arm first (armbridge relax)")

    @contextlib.contextmanager
    def holding(self, goal_ticks: int | None = None) -> Iterator[int]:
        """Hold with reduced torque within the context; torque is off after it, also after an exception.

        Args:
            goal_ticks: goal at torque on, at most STEP_TICKS away; None for the present position.

        Yields:
            Goal [ticks].
        """
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


def _behind_missing(rig: ServoRig) -> Finding:
    name = "sync read past a missing servo"
    missing = next(servo_id for servo_id in reversed(SERVO_IDS) if servo_id not in rig.present_ids)
    asked = (rig.present_ids[0], missing, *rig.present_ids[1:])
    frames = rig.bus.sync_read(asked, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
    silent = [servo_id for servo_id in rig.present_ids if servo_id not in frames]
    if not silent:
        return Finding(name, Verdict.GOOD, "those behind it answer")
    says = f"servos {', '.join(map(str, silent))} did not answer behind the missing one"
    return Finding(name, Verdict.NOTE, says, "One servo that falls silent ends motions of the whole arm.")


def _return_delay_experiment(rig: ServoRig) -> Finding:
    name = "return delay register"
    before = rig.read(Register.RETURN_DELAY)
    # With LOCK 1 the value acts, and is gone with the next power cut.
    rig.set(Register.LOCK, 1)
    # Turn by turn, and the quickest of each: a busy machine makes replies late, never early.
    times: dict[int, list[float]] = {0: [], LONG_RETURN_DELAY: []}
    try:
        for _ in range(RETURN_DELAY_READS):
            for delay, taken_s in times.items():
                rig.set(Register.RETURN_DELAY, delay)
                taken_s += measure_reads(rig.bus, rig.servo_id, TELEMETRY_ADDRESS, TELEMETRY_BYTES, 1, rig.clock)
    finally:
        rig.set(Register.RETURN_DELAY, before)
    if not all(times.values()):
        return _open(name, "too many replies were lost")
    added_s = min(times[LONG_RETURN_DELAY]) - min(times[0])
    effect = "works" if added_s > RETURN_DELAY_SEEN_S else "does nothing"
    return Finding(name, Verdict.GOOD, f"{LONG_RETURN_DELAY} makes replies {added_s * 1e6:.0f} us later: it {effect}")


def _overload(rig: ServoRig) -> Finding:
    name = "overload cleared by torque off and on"
    overloaded = [i for i in rig.present_ids if rig.bus.read(i, Register.STATUS) & StatusFlag.OVERLOAD]
    if not overloaded:
        return _open(name, "no servo is overloaded; run this again when one is")
    servo = replace(rig, servo_id=overloaded[0])
    with servo.holding():
        rig.wait(STEP_S)
        still = servo.read(Register.STATUS) & StatusFlag.OVERLOAD
    if still:
        return Finding(name, Verdict.NOTE, "it does not", "Switch the servos' supply off and on after an overload.")
    return Finding(name, Verdict.GOOD, "it does")


def _goal_register(rig: ServoRig) -> Finding:
    name = "goal register and torque"
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
        says += "; torque on drives to a goal set before: it must be set to the present position first"
    elif held != stale:
        says += f"; torque on changes a goal set before from {stale} to {held}"
    else:
        says += "; torque on does not drive to a goal set before"
    return Finding(name, Verdict.GOOD, says)


def _damping(rig: ServoRig) -> Finding:
    name = "damping (torque 2)"
    rig.require_relaxed()
    try:
        rig.bus.write(rig.servo_id, Register.TORQUE_ENABLE, DAMPING)
        held = rig.read(Register.TORQUE_ENABLE)
    finally:
        rig.set(Register.TORQUE_ENABLE, 0)
    taken = "takes" if held == DAMPING else f"does not take (it reads back {held})"
    return Finding(name, Verdict.GOOD, f"the servo {taken} the value 2")


def _current_sign(rig: ServoRig) -> Finding:
    name = "sign of the current"
    with rig.holding() as start:
        runs = [rig.go(target) for target in (rig.one_step_from(start), start)]
    peaks = [max((sample.current_a for _, sample in samples), key=abs) for samples in runs]
    says = f"peaks of {peaks[0]:+.3f} A and {peaks[1]:+.3f} A in opposite directions"
    if min(abs(peak) for peak in peaks) < CURRENT_SEEN_A:
        return _open(name, f"{says}: too little to tell")
    return Finding(name, Verdict.GOOD, f"{says}: the register is {'signed' if peaks[0] * peaks[1] < 0 else 'unsigned'}")


def _lag(rig: ServoRig) -> Finding:
    name = "lag of the position loop"
    gain = rig.read(Register.P_GAIN)
    with rig.holding() as start:
        goal = rig.one_step_from(start)
        samples = rig.go(goal)
    shares = [(at_s, (sample.position_ticks - start) / (goal - start)) for at_s, sample in samples]
    reached = [at_s for at_s, share in shares if share >= RISE_SHARE]
    if not reached:
        return _open(name, f"the servo did {max(share for _, share in shares):.0%} of a step in {STEP_S} s")
    says = f"a step of {STEP_TICKS} ticks is followed within {reached[0] * 1e3:.0f} ms (P gain {gain})"
    return Finding(name, Verdict.GOOD, says)


def _power_up(rig: ServoRig) -> Finding:
    name = "torque at power-up"
    if not rig.await_answers(answering=False):
        return _open(name, f"the power was not cut within {POWER_TIMEOUT_S:.0f} s")
    if not rig.await_answers(answering=True):
        return _open(name, f"the servo did not come back within {POWER_TIMEOUT_S:.0f} s")
    rig.wait(BOOT_S)
    driven = [str(i) for i in rig.present_ids if rig.bus.read(i, Register.TORQUE_ENABLE)]
    if driven:
        says = f"servos {', '.join(driven)} power up with torque on"
        return Finding(name, Verdict.NOTE, says, "Keep clear when switching the supply on.")
    return Finding(name, Verdict.GOOD, "off")


def _open(name: str, says: str) -> Finding:
    return Finding(name, Verdict.OPEN, says)


EXPERIMENTS = (
    Experiment("sync read past a missing servo", "reads only", False, False, _behind_missing),
    Experiment(
        "return delay register",
        "changes how long one servo waits before it replies, for a moment; not stored",
        False,
        False,
        _return_delay_experiment,
    ),
    Experiment(
        "overload cleared by torque off and on",
        "switches an overloaded servo, if there is one, off, on where it is, and off: hold the arm",
        True,
        False,
        _overload,
    ),
    Experiment(
        "goal register and torque", "moves the servo by 2 degrees at a fifth of its torque", True, False, _goal_register
    ),
    Experiment("damping (torque 2)", "writes 2 to the servo's torque register, then 0", True, False, _damping),
    Experiment(
        "sign of the current",
        "moves the servo by 2 degrees and back at a fifth of its torque",
        True,
        False,
        _current_sign,
    ),
    Experiment("lag of the position loop", "moves the servo by 2 degrees at a fifth of its torque", True, False, _lag),
    Experiment(
        "torque at power-up",
        "wants you to hold the arm, switch the servos' supply off, wait two seconds, and switch it on",
        False,
        True,
        _power_up,
    ),
)
