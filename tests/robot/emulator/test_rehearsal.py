from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from robot.calibration import MAX_TICK, Calibration, save
from robot.emulator.adapter import InProcessPort
from robot.emulator.control import Emulation, LiveCommand, answer, check
from robot.emulator.feetech import FEETECH, FeetechServo, build_servos
from robot.emulator.process import add_options, build_rehearsal
from robot.emulator.rehearsal import LEAD_S, REHEARSALS, Rehearsal, TimedCommand, push, read_script, stall, sweep
from robot.emulator.servo_bus import Faults, ServoBus
from robot.hardware.feetech.registers import Register, encode
from tests.helpers.robots import nominal_calibration

TICK_S = 0.02
START_S = 100.0
ELBOW = 2

NOMINAL = nominal_calibration()
# The middle of a joint is not that of the encoder, and no two ranges are alike.
MEASURED = Calibration(
    tuple(
        joint
        if joint.servo.turns_freely
        else replace(
            joint, homing_offset=-300 + 150 * k, range_min=joint.range_min + 60, range_max=joint.range_max - 20
        )
        for k, joint in enumerate(NOMINAL.joints)
    )
)
ARMS = pytest.mark.parametrize("calibration", [NOMINAL, MEASURED], ids=["nominal", "measured"])

HOLD = TimedCommand(0.0, {"hand": {"3": 2000}})
LET_GO = TimedCommand(2.0, {"hand": {"3": None}})

Build = Callable[..., Rehearsal]


def bus_of(calibration: Calibration = NOMINAL) -> ServoBus[FeetechServo]:
    return ServoBus(build_servos(calibration, [0.0] * len(calibration.joints)), FEETECH, Faults(), 0.0)


def played(
    commands: Sequence[TimedCommand],
    calibration: Calibration,
    prepare: Callable[[ServoBus[FeetechServo]], None] = lambda bus: None,
) -> Iterator[tuple[float, tuple[FeetechServo, ...]]]:
    """Play commands to servos in a time of their own; yields it, from the start on, with the servos."""
    bus = bus_of(calibration)
    emulation = Emulation(bus, InProcessPort(bus, lambda: 0.0))
    rehearsal = Rehearsal(commands)
    prepare(bus)
    rehearsal.start(0.0)
    for tick in range(round((commands[-1].at_s + 2.0) / TICK_S)):
        now_s = tick * TICK_S
        bus.advance(now_s)
        for due in rehearsal.commands_due(now_s):
            assert json.loads(answer(json.dumps(due.command).encode(), emulation)) == {"ok": True}
        yield now_s, bus.servos


def hold_the_elbow_at(goal_ticks: int) -> Callable[[ServoBus[FeetechServo]], None]:
    def hold(bus: ServoBus[FeetechServo]) -> None:
        elbow = bus.servos[ELBOW]
        elbow.write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, goal_ticks))
        elbow.write(Register.TORQUE_LIMIT, encode(Register.TORQUE_LIMIT, 800))
        elbow.write(Register.TORQUE_ENABLE, bytes([1]))

    return hold


def test_every_command_is_due_once_at_its_time_from_the_first_start() -> None:
    rehearsal = Rehearsal([HOLD, LET_GO])
    assert rehearsal.commands_due(START_S) == []
    rehearsal.start(START_S)
    rehearsal.start(START_S + 1.0)
    assert rehearsal.commands_due(START_S) == [HOLD]
    assert rehearsal.commands_due(START_S + 1.99) == []
    assert rehearsal.commands_due(START_S + 2.0) == [LET_GO]
    assert rehearsal.commands_due(START_S + 1000.0) == []


def test_a_script_that_repeats_starts_again_after_its_last_command() -> None:
    rehearsal = Rehearsal([HOLD, LET_GO], repeats=True)
    rehearsal.start(START_S)
    assert rehearsal.commands_due(START_S + 2.0) == [HOLD, LET_GO]
    assert rehearsal.commands_due(START_S + 2.0) == [HOLD]
    assert rehearsal.commands_due(START_S + 3.9) == []
    assert rehearsal.commands_due(START_S + 4.0) == [LET_GO]
    # Rounds that a suspended machine missed are not made up for.
    assert rehearsal.commands_due(START_S + 3600.0) == [HOLD, LET_GO]
    assert rehearsal.commands_due(START_S + 3600.0) == [HOLD]
    assert rehearsal.commands_due(START_S + 3601.0) == []


@pytest.mark.parametrize(("commands", "error_text"), [([HOLD], "it is 0"), ([], "there is none")])
def test_a_script_that_takes_no_time_is_not_repeated(commands: list[TimedCommand], error_text: str) -> None:
    with pytest.raises(ValueError, match=rf"its last at_s is 0\.1 or more; {error_text}"):
        Rehearsal(commands, repeats=True)


def test_a_script_is_read_line_by_line(tmp_path: Path) -> None:
    file = tmp_path / "script.jsonl"
    file.write_text('{"at_s": 0, "hand": {"3": 2000}}\n\n{"at_s": 2, "hand": {"3": null}, "drop": 0.5}\n{"at_s": 2.5}')
    assert read_script(file, bus_of()) == (
        HOLD,
        TimedCommand(2.0, {"hand": {"3": None}, "drop": 0.5}),
        TimedCommand(2.5, {}),
    )


@pytest.mark.parametrize(
    ("line", "error_text"),
    [
        ('{"at_s": 1, "hand": {"3": 1900}}', "at_s: must be more than the 1 of the line before, not 1"),
        ('{"at_s": 2, "hand": {"3": 5000}}', "hand.3: must be less than or equal to 4095, not 5000"),
        (
            '{"at_s": 2, "offline": [7]}',
            "offline.0: must be a servo id out of 1, 2, 3, 4, 5, 6, or a joint's name, not 7",
        ),
        ('{"at_s": 2, "explode": 1}', "unknown command 'explode'"),
        ('{"at_s": -1}', "at_s: must be greater than or equal to 0, not -1"),
        ('{"at_s": 90000}', "at_s: must be less than or equal to 86400, not 90000"),
        ('{"at_s": NaN}', "at_s: must be a finite number, not nan"),
        ('{"at_s": "2"}', "at_s: must be a valid number, not '2'"),
        ('{"at_s": true}', "at_s: must be a valid number, not True"),
        ('{"drop": 0.5}', "at_s: is missing"),
        ("[2]", "a command is a JSON object, not [2]"),
        ('{"at_s" 2}', "no JSON at column 9: Expecting ':' delimiter"),
    ],
)
def test_a_line_that_cannot_be_is_refused_with_file_and_number(tmp_path: Path, line: str, error_text: str) -> None:
    file = tmp_path / "script.jsonl"
    file.write_text(f'{{"at_s": 1}}\n\n{line}\n')
    with pytest.raises(ValueError, match="^" + re.escape(f"{file}, line 3: {error_text}")):
        read_script(file, bus_of())


def test_a_script_without_commands_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "script.jsonl"
    file.write_text("\n")
    with pytest.raises(ValueError, match=re.escape(f"{file}: the script has no commands")):
        read_script(file, bus_of())


@ARMS
@pytest.mark.parametrize("name", REHEARSALS)
def test_the_commands_of_a_rehearsal_make_sense_and_have_increasing_times(name: str, calibration: Calibration) -> None:
    commands = REHEARSALS[name](calibration)
    for timed in commands:
        check(LiveCommand, timed.command, bus_of(calibration).servos)
    assert all(before.at_s < after.at_s for before, after in pairwise(commands))


@ARMS
def test_a_sweep_holds_the_middle_and_then_brings_every_joint_to_both_stops_and_back(calibration: Calibration) -> None:
    middle = [(joint.range_min + joint.range_max) // 2 for joint in calibration.joints]
    (free,) = [k for k, joint in enumerate(calibration.joints) if joint.servo.turns_freely]
    lowest, highest = [MAX_TICK] * 6, [0] * 6
    *_, let_go = commands = sweep(calibration)
    for now_s, servos in played(commands, calibration):
        present = [servo.present_ticks for servo in servos]
        if 1.0 <= now_s < LEAD_S or let_go.at_s - 0.1 < now_s < let_go.at_s:
            assert present == middle
        # calibrate takes the middle of a joint that turns freely from wherever the arm is when Enter is pressed.
        assert abs(present[free] - MAX_TICK / 2) <= 1.0
        lowest, highest = list(map(min, lowest, present)), list(map(max, highest, present))
    for joint, low, high in zip(calibration.joints, lowest, highest, strict=True):
        if not joint.servo.turns_freely:
            assert (low, high) == (joint.range_min, joint.range_max)
    assert all(servo.plant.hand_ticks is None for servo in servos)


def test_a_joint_that_holds_gives_way_to_a_push_and_comes_back() -> None:
    start, end = (timed.at_s for timed in push(NOMINAL))
    away = {}
    for now_s, servos in played(push(NOMINAL), NOMINAL, hold_the_elbow_at(2047)):
        away[round(now_s, 2)] = abs(servos[ELBOW].present_ticks - 2047)
    assert away[start - 1.0] <= 5
    assert 20 <= away[end - 1.0] <= 50
    assert away[end + 1.0] <= 5


def test_a_joint_stalls_at_the_obstacle_and_goes_on_when_it_is_taken_away() -> None:
    start, end = (timed.at_s for timed in stall(NOMINAL))
    ticks = {}
    for now_s, servos in played(stall(NOMINAL), NOMINAL, hold_the_elbow_at(2047)):
        elbow = servos[ELBOW]
        if abs(now_s - start - 1.0) < TICK_S / 2:
            elbow.write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, 2373))
        ticks[round(now_s, 2)] = elbow.present_ticks
    (obstacle,) = stall(NOMINAL)[0].command["obstacle"].values()
    assert ticks[start + 2.5] == obstacle < 2373 - 60
    assert ticks[end + 1.0] == pytest.approx(2373, abs=5)


@pytest.fixture
def built(tmp_path: Path) -> Build:
    """Builds the rehearsal that a command line asks for."""

    def build(*arguments: str) -> Rehearsal:
        parser = argparse.ArgumentParser()
        add_options(parser)
        return build_rehearsal(parser.parse_args(arguments), bus_of())

    return build


@pytest.mark.parametrize("name", REHEARSALS)
def test_a_rehearsal_is_that_of_the_arm_which_is_emulated(built: Build, tmp_path: Path, name: str) -> None:
    save(MEASURED, tmp_path / "arm.json")
    assert built("--rehearse", name).commands == REHEARSALS[name](NOMINAL)
    assert built("--rehearse", name, "--calibration", str(tmp_path / "arm.json")).commands == REHEARSALS[name](MEASURED)


@pytest.mark.parametrize("ready_made", [True, False])
def test_either_kind_of_script_can_be_repeated(built: Build, tmp_path: Path, ready_made: bool) -> None:
    file = tmp_path / "script.jsonl"
    file.write_text('{"at_s": 0, "hand": {"3": 2000}}\n{"at_s": 2, "hand": {"3": null}}\n')
    rehearsal = built("--repeat", *(["--rehearse", "push"] if ready_made else ["--script", str(file)]))
    rehearsal.start(START_S)
    last_s = START_S + rehearsal.commands[-1].at_s
    assert rehearsal.commands_due(last_s) == list(rehearsal.commands)
    assert rehearsal.commands_due(2 * last_s) == list(rehearsal.commands)


def test_without_a_script_nothing_is_played_or_can_be_repeated(built: Build) -> None:
    assert built().commands == ()
    with pytest.raises(ValueError, match="--repeat needs a script to repeat: --script or --rehearse"):
        built("--repeat")
