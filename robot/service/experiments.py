"""Questions about the servos that no document answers, each asked of a real one.

An experiment that switches torque uses one servo, at a fifth of its torque, within 25 ticks (2 deg) of where it is,
only if it is relaxed, and leaves it relaxed. Nothing that is written outlives a power cut. The driver works whatever
the answers are, since it reads back what it relies on; they are worth knowing all the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import SERVO_IDS
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES, Register
from robot.hardware.interface import StatusFlag
from robot.service.bench import POWER_TIMEOUT_S, STEP_S, STEP_TICKS, Bench
from robot.service.doctor import Finding, Verdict
from robot.service.measuring import measure_reads

# A servo that has come this far of a step has followed it.
FOLLOWED_TICKS = STEP_TICKS // 2

# Time constant of a step's answer: where 63 % of it are done.
RISE_SHARE = 0.63

# Register RETURN_DELAY: lerobot's comment names 250 (500 us) as the factory's value.
LONG_RETURN_DELAY = 250
RETURN_DELAY_READS = 30
RETURN_DELAY_SEEN_S = 0.0003

# TORQUE_ENABLE 2, which one vendor's document calls damping.
DAMPING = 2

# Current below this is noise of the measurement [A].
CURRENT_SEEN_A = 0.02

# A servo that has just got power is given time to start.
BOOT_S = 0.5


@dataclass(frozen=True)
class Experiment:
    """One question.

    Attributes:
        name: short name.
        does: what will happen to the arm, for the person who is asked to agree.
        switches_torque: whether a servo will be driven.
        needs_hands: whether a person must do something meanwhile.
        run: asks it; raises NoReply, StartupError or PortLost when the servo does not play along.
    """

    name: str
    does: str
    switches_torque: bool
    needs_hands: bool
    run: Callable[[Bench], Finding]


def ask(experiment: Experiment, bench: Bench) -> Finding:
    """Carry out an experiment; a servo that does not play along leaves its question open.

    Raises:
        PortLost: the port is gone.
    """
    try:
        return experiment.run(bench)
    except (NoReply, StartupError) as error:
        return _open(experiment.name, str(error))


def _behind_missing(bench: Bench) -> Finding:
    name = "sync read past a missing servo"
    missing = next(servo_id for servo_id in reversed(SERVO_IDS) if servo_id not in bench.present_ids)
    asked = (bench.present_ids[0], missing, *bench.present_ids[1:])
    frames = bench.bus.sync_read(asked, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
    silent = [servo_id for servo_id in bench.present_ids if servo_id not in frames]
    if not silent:
        return Finding(name, Verdict.GOOD, "those behind it answer")
    says = f"servos {', '.join(map(str, silent))} did not answer behind the missing one"
    return Finding(name, Verdict.NOTE, says, "One servo that falls silent ends motions of the whole arm.")


def _return_delay(bench: Bench) -> Finding:
    name = "return delay register"
    before = bench.read(Register.RETURN_DELAY)
    # With LOCK 1 the value acts, and is gone with the next power cut.
    bench.set(Register.LOCK, 1)
    # Turn by turn, and the quickest of each: a busy machine makes replies late, never early.
    times: dict[int, list[float]] = {0: [], LONG_RETURN_DELAY: []}
    try:
        for _ in range(RETURN_DELAY_READS):
            for delay, taken_s in times.items():
                bench.set(Register.RETURN_DELAY, delay)
                taken_s += measure_reads(bench.bus, bench.servo_id, TELEMETRY_ADDRESS, TELEMETRY_BYTES, 1, bench.clock)
    finally:
        bench.set(Register.RETURN_DELAY, before)
    if not all(times.values()):
        return _open(name, "too many replies were lost")
    added_s = min(times[LONG_RETURN_DELAY]) - min(times[0])
    effect = "works" if added_s > RETURN_DELAY_SEEN_S else "does nothing"
    return Finding(name, Verdict.GOOD, f"{LONG_RETURN_DELAY} makes replies {added_s * 1e6:.0f} us later: it {effect}")


def _overload(bench: Bench) -> Finding:
    name = "overload cleared by torque off and on"
    overloaded = [i for i in bench.present_ids if bench.bus.read(i, Register.STATUS) & StatusFlag.OVERLOAD]
    if not overloaded:
        return _open(name, "no servo is overloaded; run this again when one is")
    servo = replace(bench, servo_id=overloaded[0])
    with servo.holding():
        bench.wait(STEP_S)
        still = servo.read(Register.STATUS) & StatusFlag.OVERLOAD
    if still:
        return Finding(name, Verdict.NOTE, "it does not", "Switch the servos' supply off and on after an overload.")
    return Finding(name, Verdict.GOOD, "it does")


def _goal_register(bench: Bench) -> Finding:
    name = "goal register and torque"
    with bench.holding() as start:
        goal = bench.one_step_from(start)
        bench.set_goal(goal)
        bench.wait(STEP_S)
    kept = bench.read(Register.GOAL_POSITION)
    here = bench.telemetry().position_ticks
    with bench.holding(here + start - goal) as stale:
        bench.wait(STEP_S)
        moved = bench.telemetry().position_ticks - here
        held = bench.read(Register.GOAL_POSITION)
    says = "torque off keeps the goal" if kept == goal else f"torque off changes the goal from {goal} to {kept}"
    if abs(moved) >= FOLLOWED_TICKS:
        says += "; torque on drives to a goal set before: it must be set to the present position first"
    elif held != stale:
        says += f"; torque on changes a goal set before from {stale} to {held}"
    else:
        says += "; torque on does not drive to a goal set before"
    return Finding(name, Verdict.GOOD, says)


def _damping(bench: Bench) -> Finding:
    name = "damping (torque 2)"
    bench.require_relaxed()
    try:
        bench.bus.write(bench.servo_id, Register.TORQUE_ENABLE, DAMPING)
        held = bench.read(Register.TORQUE_ENABLE)
    finally:
        bench.set(Register.TORQUE_ENABLE, 0)
    taken = "takes" if held == DAMPING else f"does not take (it reads back {held})"
    return Finding(name, Verdict.GOOD, f"the servo {taken} the value 2")


def _current_sign(bench: Bench) -> Finding:
    name = "sign of the current"
    with bench.holding() as start:
        runs = [bench.go(target) for target in (bench.one_step_from(start), start)]
    peaks = [max((sample.current_a for _, sample in samples), key=abs) for samples in runs]
    says = f"peaks of {peaks[0]:+.3f} A and {peaks[1]:+.3f} A in opposite directions"
    if min(abs(peak) for peak in peaks) < CURRENT_SEEN_A:
        return _open(name, f"{says}: too little to tell")
    return Finding(name, Verdict.GOOD, f"{says}: the register is {'signed' if peaks[0] * peaks[1] < 0 else 'unsigned'}")


def _lag(bench: Bench) -> Finding:
    name = "lag of the position loop"
    gain = bench.read(Register.P_GAIN)
    with bench.holding() as start:
        goal = bench.one_step_from(start)
        samples = bench.go(goal)
    shares = [(at_s, (sample.position_ticks - start) / (goal - start)) for at_s, sample in samples]
    reached = [at_s for at_s, share in shares if share >= RISE_SHARE]
    if not reached:
        return _open(name, f"the servo did {max(share for _, share in shares):.0%} of a step in {STEP_S} s")
    says = f"a step of {STEP_TICKS} ticks is followed within {reached[0] * 1e3:.0f} ms (P gain {gain})"
    return Finding(name, Verdict.GOOD, says)


def _power_up(bench: Bench) -> Finding:
    name = "torque at power-up"
    if not bench.await_answers(answering=False):
        return _open(name, f"the power was not cut within {POWER_TIMEOUT_S:.0f} s")
    if not bench.await_answers(answering=True):
        return _open(name, f"the servo did not come back within {POWER_TIMEOUT_S:.0f} s")
    bench.wait(BOOT_S)
    driven = [str(i) for i in bench.present_ids if bench.bus.read(i, Register.TORQUE_ENABLE)]
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
        _return_delay,
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
