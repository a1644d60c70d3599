import io
import itertools
import json
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from planners.errors import PlottingError
from planners.files import plan_command, problem_file
from planners.files.plan_command import EXIT_EXPECTED, EXIT_UNEXPECTED, EXIT_USAGE, Options
from planners.goals import JointGoal
from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE
from robot.trajectory import Trajectory
from tests.helpers.robots import so101

MOTION = Trajectory(
    ("a", "b"), np.array([0.0, 1.0]), np.array([[0.0, 0.0], [1.0, 2.0]]), np.zeros((2, 2)), np.zeros((2, 2))
)


def test_motions_that_fit_are_pictured_if_there_are_any_and_matplotlib(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(plan_command, "MAX_MOTIONS", 1)
    plan_command.plot(tmp_path / "one.png", [("one", MOTION)])
    plan_command.plot(tmp_path / "two.png", [("one", MOTION), ("two", MOTION)])
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    with pytest.raises(PlottingError, match="no motion"):
        plan_command.plot(tmp_path / "none.png", [])
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(sys, "modules", {name: each for name, each in sys.modules.items() if "matplotlib" not in name})
    with pytest.raises(PlottingError, match="pip install matplotlib"):
        plan_command.check_available()


# With its hulls alone it is loaded in no time.
ROBOT = replace(so101(), parts={}, surfaces={})
ARM = ROBOT.groups["arm"].joints
REVERSED = tuple(reversed(ARM))
HOME, NEAR = [0.0] * 5, [0.1, 0.2, 0.3, 0.4, 0.5]
LIMITS = {"velocity": [1.0] * 5, "acceleration": [2.0] * 5, "lower": [-1.5] * 5, "upper": [1.5] * 5}


@pytest.fixture
def path(tmp_path):
    fields = {
        "format": problem_file.FORMAT,
        "name": "made",
        "joint_names": REVERSED,
        "limits": LIMITS,
        "joint_problems": [{"id": "near", "start": HOME, "goal": NEAR}],
        "position_problems": [{"id": "tip", "start": HOME, "position": [0.3, 0.1, 0.2], "tolerance": 0.005}],
        "infeasible": [{"id": "far", "start": HOME, "goal": [2.0] * 5, "accept_codes": [-16]}],
    }
    path = tmp_path / "problems.json"
    path.write_text(json.dumps(fields))
    return path


class Run:
    """The command, run."""

    def __init__(self, options: Options) -> None:
        output, errors = io.StringIO(), io.StringIO()
        self.code = plan_command.run(options, ROBOT, output, errors)
        self.lines, self.errors = output.getvalue().splitlines(), errors.getvalue().splitlines()


def answers(path, more=(), **options):
    out = path.with_name("out.json")
    run = Run(Options([path, *more], json_path=out, **options))
    return run, json.loads(out.read_text())


def test_answers_are_written_with_a_line_for_each_in_the_order_of_the_files_joints_and_within_its_limits(path) -> None:
    run, (answer, _, refused) = answers(path, every=True)
    assert set(answer) == {"problem", "time_from_start", "positions", "velocities", "accelerations"}
    assert (answer["positions"][0], answer["positions"][-1]) == (HOME, NEAR)
    shape = (len(answer["time_from_start"]), 5)
    assert all(np.shape(answer[key]) == shape for key in ("positions", "velocities", "accelerations"))
    assert np.max(np.abs(answer["velocities"])) <= LIMITS["velocity"][0] + 1e-9
    assert np.max(np.abs(answer["accelerations"])) <= LIMITS["acceleration"][0] + 1e-9
    assert set(refused) == {"problem", "error_code", "message"}
    assert refused["error_code"] == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "1.5 rad" in refused["message"]
    assert run.lines[0].split() == ["problem", "code", "CPU", "[ms]", "duration", "[s]", "length", "[rad]"]
    name, code, word, cpu, duration, length = run.lines[1].split()
    assert (name, code, word) == ("near", "1", "SUCCESS")
    assert float(cpu) > 0.0
    assert float(duration) > 0.5
    assert float(length) == pytest.approx(np.linalg.norm(NEAR), abs=0.001)
    assert run.lines[-1] == "3 of 3 answered as the file expects"


def test_an_unexpected_answer_is_exit_1_and_so_is_a_scene_that_cannot_be_used(path, monkeypatch) -> None:
    text = path.read_text()
    path.write_text(text.replace("-16", "-12"))
    assert Run(Options([path], every=True)).code == EXIT_UNEXPECTED
    flat = {"id": "flat", "type": "box", "dimensions": [0.1, 0.1, 0.0]}
    path.write_text(json.dumps({**json.loads(text), "objects": [flat]}))
    run, written = answers(path)
    assert run.code == EXIT_UNEXPECTED
    assert all("flat" in answer["message"] for answer in written)
    # The allowed time is processor time.
    path.write_text(text)
    seconds = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: 10.0 * next(seconds))
    _, written = answers(path)
    assert [answer["error_code"] for answer in written] == [MoveItErrorCode.TIMED_OUT] * 2


def test_a_saved_failure_or_success_that_ends_again_in_the_same_way_is_exit_0(tmp_path) -> None:
    beyond = JointGoal(dict.fromkeys(ARM, 9.0))
    failed = PlanningFailure(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "beyond the limits")
    solved = PlanningFailure(MoveItErrorCode.SUCCESS, "the arm is there")
    for goal, outcome, line in (
        (beyond, failed, "1 of them failed as on the server that saved the problem"),
        (JointGoal(dict(zip(REVERSED, NEAR, strict=True))), solved, "1 of 1 answered as the file expects"),
    ):
        saved = tmp_path / "goal-7.json"
        problem = PlanningProblem("arm", dict.fromkeys(ROBOT.joints, 0.0), goal)
        saved.write_text(problem_file.text("goal-7", problem, EMPTY_SCENE, ROBOT, outcome))
        run = Run(Options([saved]))
        assert (run.code, run.lines[-1]) == (EXIT_EXPECTED, line)


def test_problems_of_several_files_are_told_apart_by_their_paths(path) -> None:
    other = path.with_name("other.json")
    other.write_text(path.read_text())
    run, written = answers(path, more=[other], ids=("near", "far"))
    expected = [(str(file), name) for file in (path, other) for name in ("near", "far")]
    assert [(answer["file"], answer["problem"]) for answer in written] == expected
    shown = [line.split()[0] for line in run.lines[1:] if line[0] == "/"]
    assert shown == [f"{file}:{name}" for file, name in expected]
    assert run.lines[-1] == "4 of 4 answered as their files expect"


def test_on_a_terminal_answers_are_counted_as_they_come_and_a_plot_is_drawn(path) -> None:
    errors, picture = io.StringIO(), path.with_name("out.png")
    errors.isatty = lambda: True
    plan_command.run(Options([path], plot_path=picture), ROBOT, io.StringIO(), errors)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [text for text in errors.getvalue().split("\r\x1b[K") if text] == ["1/2", "2/2"]


def test_an_impossible_request_is_one_line_and_exit_2(path) -> None:
    for options, words in (
        (Options([path.with_name("none.json")]), "cannot be read"),
        (Options([path, path], ids=("near", "lost")), "'lost'"),
        (Options([path], json_path=path.parent / "none" / "out.json"), "none"),
        (Options([path], plot_path=path.with_name("a.teapot")), "teapot"),
    ):
        run = Run(options)
        assert run.code == EXIT_USAGE
        (line,) = run.errors
        assert words in line
