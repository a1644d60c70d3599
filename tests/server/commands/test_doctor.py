from __future__ import annotations

import json

from robot.calibration import Calibration, save
from robot.commissioning.experiments import EXPERIMENTS
from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.server import read_write_log

QUICK = ("--cycles", "20")


def findings(text):
    return {each["check"]: each for each in json.loads(text)}


def test_every_check_and_every_question_has_a_finding(armbridge_on_terminal):
    answer = armbridge_on_terminal("doctor", "--yes", "--json", *QUICK)
    found = findings(answer.stdout)
    assert {experiment.name for experiment in EXPERIMENTS} < set(found)
    assert found["servos"]["verdict"] == found["long reads"]["verdict"] == "good"
    assert found["torque at power-up"]["says"] == "not asked"
    assert "it works" in found["return delay register"]["says"]


def test_nothing_is_asked_of_the_arm_without_a_yes(armbridge):
    answer = armbridge("doctor", "--json", *QUICK, answers="no\n" * len(EXPERIMENTS))
    found = findings(answer.stdout)
    assert all(found[experiment.name]["says"] == "not asked" for experiment in EXPERIMENTS)
    assert answer.stderr.count("[y/N]") == len(EXPERIMENTS)


def test_a_question_is_asked_of_the_arm_after_a_yes(armbridge):
    answer = armbridge("doctor", "--json", *QUICK, answers="y\n" + "\n" * len(EXPERIMENTS))
    assert findings(answer.stdout)[EXPERIMENTS[0].name]["says"] == "those behind it answer"


def test_questions_that_nobody_answers_end_the_command(armbridge):
    answer = armbridge("doctor", *QUICK)
    assert answer.returncode == ExitCode.FAILED
    assert "the input ended" in answer.stderr


def test_a_read_only_visit_writes_nothing(armbridge, write_log):
    answer = armbridge("doctor", "--read-only", *QUICK)
    assert write_log.exists()
    assert read_write_log(write_log) == []
    assert "verdict" in answer.stdout


def test_problems_are_listed_with_what_to_do_and_exit_3(emulator, armbridge, tmp_path):
    file = tmp_path / "arm.json"
    save(Calibration.nominal(), file)
    emulator.command(temperature={"2": 70})
    answer = armbridge("doctor", "--calibration", str(file), "--read-only", *QUICK)
    assert answer.returncode == ExitCode.PROBLEMS
    assert "problem  temperature" in answer.stdout
    assert "* temperature: Relax the arm" in answer.stdout
    assert "the servos hold what the file says" in answer.stdout


def test_an_arm_that_does_not_answer_is_a_finding_and_no_failure(emulator, armbridge):
    emulator.command(offline=[1, 2, 3, 4, 5, 6])
    answer = armbridge("doctor", "--json")
    assert answer.returncode == ExitCode.PROBLEMS
    assert "power supply" in answer.stdout


def test_a_calibration_that_is_not_there_is_refused(armbridge):
    answer = armbridge("doctor", "--calibration", "nobodys")
    assert answer.returncode == ExitCode.FAILED
    assert "lerobot has none of that id" in answer.stderr


def test_less_than_one_cycle_is_called_wrongly(capsys):
    assert cli.main(["doctor", "--cycles", "0"]) == ExitCode.USAGE
