"""``armbridge calibrate`` on stepped servos: the hand moves while the command sleeps between its readings."""

import functools
import itertools
import os
import signal
from collections.abc import Callable, Iterator, Sequence

import pytest

from robot.calibration import Calibration, save
from robot.emulator.plant import HAND_TICKS_S
from robot.emulator.process import sweep
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import run_to_end
from server.commands import calibrate
from server.commands.terminal import ExitCode
from tests.helpers.robots import SO101_SERVOS, nominal_calibration

STOPS = {joint.servo_id: (joint.range_min, joint.range_max) for joint in nominal_calibration().joints}
MIDDLE = 2040
ELBOW, ROLL, GRIPPER = 3, 5, 6

# One thing that a person does: move joints by hand, or type a line.
Deed = dict[int, int] | str

TO_MIDDLE = dict.fromkeys(STOPS, MIDDLE)
SWEEP = [
    {servo: stops[0] for servo, stops in STOPS.items() if servo != ROLL},
    {servo: stops[1] for servo, stops in STOPS.items() if servo != ROLL},
    TO_MIDDLE,
]
# The sweep, and the middle of the joint that turns freely.
MEASURED = [*SWEEP, "", ""]


@pytest.fixture
def person(emulator, monkeypatch) -> Iterator[Callable[[Sequence[Deed]], int]]:
    """Prepares a person: returns the input with all that they type, one deed for each time that the command sleeps."""
    read_end, write_end = os.pipe()
    emulator.command(hand={str(servo): ticks for servo, ticks in TO_MIDDLE.items()})
    emulator.run(1.0)
    to_do: list[Deed] = []

    def sleep(_seconds):
        assert to_do, "the command asks for more than this person does"
        deed = to_do.pop(0)
        if isinstance(deed, str):
            os.write(write_end, f"{deed}\n".encode())
            return
        emulator.command(hand={str(servo): ticks for servo, ticks in deed.items()})
        emulator.run(0.2)

    def prepare(deeds):
        # A hand takes its time, and the command reads meanwhile.
        sleeps = round(max(abs(b - a) for a, b in STOPS.values()) / HAND_TICKS_S / 0.2 + 2)
        for deed in deeds:
            to_do.extend([deed] * (1 if isinstance(deed, str) else sleeps))
        return read_end

    monkeypatch.setattr(calibrate.time, "sleep", sleep)
    yield prepare
    for descriptor in (read_end, write_end):
        os.close(descriptor)


def held(bus, servo_id):
    registers = Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT
    return tuple(bus.read(servo_id, register) for register in registers)


def calibrated(armbridge, deeds, file, *options):
    """Calibrate into a file; returns the answer and the joints of the file."""
    answer = armbridge("calibrate", str(file), *options, descriptor=deeds)
    assert answer.returncode == ExitCode.DONE, answer.stderr
    return answer, Calibration.load(file, SO101_SERVOS).joints


def test_a_sweep_by_hand_becomes_a_file_and_a_mirrored_gripper_is_found(armbridge, person, bus, tmp_path):
    before = held(bus, ELBOW)
    # The gripper's servo falls when it opens.
    shown = ["skip", "skip", "skip", "skip", "skip", {GRIPPER: MIDDLE - 400}, "", ""]
    answer, joints = calibrated(armbridge, person(["", *MEASURED, *shown]), tmp_path / "arm.json")
    assert (joints[2].range_min, joints[2].range_max) == STOPS[ELBOW]
    assert str(joints[2].range_min) in answer.stdout
    assert held(bus, ELBOW) == before
    assert "Now open the gripper" in answer.stderr
    assert "gripper is mirrored" in answer.stderr
    assert joints[-1].drive_mode == 1


def test_an_arm_that_a_rehearsed_hand_sweeps_is_calibrated_with_its_true_ranges(armbridge, emulator, person, tmp_path):
    # The person looks on for half a minute.
    deeds = person([*[{}] * 10, "", ""])
    for timed in sweep(nominal_calibration()):
        emulator.command_later(timed.at_s, **timed.command)
    _, joints = calibrated(armbridge, deeds, tmp_path / "arm.json", "--yes", "--no-directions")
    assert {joint.servo_id: (joint.range_min, joint.range_max) for joint in joints} == STOPS


def test_on_request_the_servos_get_what_the_file_says(armbridge, person, bus, tmp_path):
    # With another offset in the servo the same stops have other ticks.
    bus.write(ELBOW, Register.HOMING_OFFSET, -900)
    deeds = person([{**deed, ELBOW: deed[ELBOW] + 900} if isinstance(deed, dict) else deed for deed in MEASURED])
    options = "--yes", "--write-servos", "--no-directions"
    _, (_, _, elbow, *_) = calibrated(armbridge, deeds, tmp_path / "arm.json", *options)
    assert elbow.homing_offset == pytest.approx(0, abs=1)
    assert held(bus, ELBOW) == (elbow.homing_offset, elbow.range_min, elbow.range_max)


def test_nothing_is_written_for_an_arm_with_a_mirrored_joint(armbridge, person, tmp_path):
    shown = ["skip", "skip", {ELBOW: MIDDLE + 400}, "", "skip all"]
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), descriptor=person(["", *MEASURED, *shown]))
    assert answer.returncode == ExitCode.PROBLEMS
    assert "elbow_flex turned the other way than the model" in answer.stderr
    assert "nothing is written: mend elbow_flex, then calibrate again" in answer.stderr
    assert not (tmp_path / "arm.json").exists()


@pytest.mark.parametrize(
    ("name", "options", "answers", "missing", "said"),
    [
        ("mine.json", (), "", [], "--overwrite"),
        ("arm.json", (), "n\n", [], "the arm was not relaxed"),
        ("arm.json", ("--yes",), "\n", [], "did not meet both stops"),
        ("arm.json", (), "", [2], "2 (shoulder_lift)"),
    ],
)
def test_an_arm_is_neither_relaxed_nor_calibrated_without_a_yes_a_sweep_all_servos_and_a_new_file(
    armbridge, emulator, tmp_path, name, options, answers, missing, said
):
    (tmp_path / "mine.json").write_text("mine")
    emulator.command(offline=missing)
    answer = armbridge("calibrate", str(tmp_path / name), *options, answers=answers)
    assert answer.returncode == ExitCode.FAILED
    assert said in answer.stderr
    assert answer.stderr.count("the arm was not relaxed") <= 1
    assert any(words in answer.stderr for words in ("relaxing", "torque is off")) is bool(options)
    assert (tmp_path / "mine.json").read_text() == "mine"
    assert not (tmp_path / "arm.json").exists()


@pytest.mark.parametrize(("typed", "code"), [("y\n", ExitCode.DONE), ("n\n", ExitCode.FAILED)])
def test_offsets_that_another_program_has_written_are_written_back_after_a_yes(armbridge, bus, tmp_path, typed, code):
    save(nominal_calibration(), tmp_path / "arm.json")
    calibrated = held(bus, ELBOW)
    bus.write(ELBOW, Register.HOMING_OFFSET, 200)
    answer = armbridge("calibrate", str(tmp_path / "arm.json"), "--write-back", answers=typed)
    assert answer.returncode == code, answer.stderr
    assert "HOMING_OFFSET" in answer.stderr
    assert held(bus, ELBOW)[0] == (calibrated[0] if code is ExitCode.DONE else 200)
    assert held(bus, ELBOW)[1:] == calibrated[1:]


@pytest.mark.parametrize(
    ("number", "step"), [*((signal.SIGINT, step) for step in range(2, 8)), (signal.SIGTERM, 5), (signal.SIGHUP, 5)]
)
def test_a_signal_between_two_writes_leaves_all_values_or_none(armbridge, bus, tmp_path, monkeypatch, number, step):
    save(nominal_calibration(), tmp_path / "arm.json")
    calibrated = held(bus, ELBOW)
    for register, shifted in ((Register.HOMING_OFFSET, 200), (Register.MIN_ANGLE_LIMIT, 900)):
        bus.write(ELBOW, register, shifted)
    before, waits = held(bus, ELBOW), itertools.count()

    def wait(_seconds):
        if next(waits) == step:
            signal.raise_signal(number)

    at_close = []
    monkeypatch.setattr(Bus, "close", lambda _bus: at_close.append((held(bus, ELBOW), bus.read(ELBOW, Register.LOCK))))
    monkeypatch.setattr(calibrate, "run_to_end", functools.partial(run_to_end, wait=wait))
    assert armbridge("calibrate", str(tmp_path / "arm.json"), "--write-back", "--yes").returncode == ExitCode.FAILED
    assert at_close[0] in ((before, 1), (calibrated, 1))
