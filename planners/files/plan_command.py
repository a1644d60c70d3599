"""``armbridge plan``: plan the problems of a file without a server."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from planners.errors import PlannerError, ProblemFileError
from planners.files import plotting, problem_file
from planners.files.problem_file import FileProblem, ProblemFile
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode, Plan, PlanningFailure
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

# Exit codes: every answer is one that the file takes as right; some are not; nothing was planned.
EXIT_EXPECTED = 0
EXIT_UNEXPECTED = 3
EXIT_USAGE = 2

_ROW = "{:<20} {:>5}  {:<26} {:>8}  {:>12}  {:>12}\n"
_HEADER = _ROW.format("problem", "code", "", "CPU [ms]", "duration [s]", "length [rad]")


@dataclass(frozen=True)
class Options:
    """What the command is called with.

    Attributes:
        path: the problem file.
        every: whether the infeasible problems are planned as well.
        ids: the problems to plan, whatever list they are in; empty for all feasible ones.
        json_path: where the answers go as JSON, or None.
        plot_path: where the plot of the motions goes, or None.
        settings: fields of :class:`PlanningProblem` that hold for every problem, whatever the file says.
    """

    path: Path
    every: bool = False
    ids: tuple[str, ...] = ()
    json_path: Path | None = None
    plot_path: Path | None = None
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What became of one problem.

    Attributes:
        asked: the problem.
        answer: its plan, or why there is none.
        cpu_s: CPU time spent on it [s].
    """

    asked: FileProblem
    answer: Plan | PlanningFailure
    cpu_s: float

    @property
    def code(self) -> MoveItErrorCode:
        """The value of moveit_msgs/MoveItErrorCodes that a server would answer."""
        return self.answer.code if isinstance(self.answer, PlanningFailure) else MoveItErrorCode.SUCCESS

    @property
    def expected(self) -> bool:
        """Whether the file takes it as a right answer."""
        return self.code in self.asked.accept_codes


def run(options: Options, robot: RobotModel, output: TextIO, errors: TextIO) -> int:
    """Plan, print a table, and write the files asked for; the exit code."""
    try:
        if options.plot_path is not None:
            plotting.check_available()
        file = problem_file.read(options.path, robot)
        outcomes = list(_printed(plan_all(file, chosen(file, options)), output))
        _write(options, file, outcomes)
    except (PlannerError, OSError) as error:
        errors.write(f"armbridge: {error}\n")
        return EXIT_USAGE
    wrong = sum(not outcome.expected for outcome in outcomes)
    output.write(f"{len(outcomes) - wrong} of {len(outcomes)} answered as the file expects\n")
    return EXIT_UNEXPECTED if wrong else EXIT_EXPECTED


def chosen(file: ProblemFile, options: Options) -> list[FileProblem]:
    """The problems to plan, with the settings of the command line.

    Raises:
        ProblemFileError: the file has no problem of an id that was named.
    """
    known = {problem.id: problem for problem in file.problems}
    for name in options.ids:
        if name not in known:
            raise ProblemFileError(str(options.path), "id", f"there is no problem {name!r}")
    wanted = [known[name] for name in options.ids] or [
        problem for problem in file.problems if options.every or problem.feasible
    ]
    return [dataclasses.replace(one, problem=dataclasses.replace(one.problem, **options.settings)) for one in wanted]


def plan_all(file: ProblemFile, problems: Sequence[FileProblem]) -> Iterator[Outcome]:
    """Plan problems of a file, one after the other.

    Raises:
        ShapeError: the robot's collision shapes cannot be used.
    """
    # As in a server's planner process: a goal that failed there fails in the same way here, however busy the machine.
    planner = Planner(file.robot, time.process_time)
    refusal = planner.set_scene(file.scene)
    for asked in problems:
        started_s = time.process_time()
        answer = refusal or planner.plan(asked.problem)
        yield Outcome(asked, answer, time.process_time() - started_s)


def as_json(outcomes: Sequence[Outcome], joint_names: Sequence[str]) -> list[dict[str, Any]]:
    """Answers as plain values, joints in the given order."""
    return [_answer_as_json(outcome, joint_names) for outcome in outcomes]


def _printed(outcomes: Iterator[Outcome], output: TextIO) -> Iterator[Outcome]:
    """The outcomes, each printed as it comes."""
    output.write(_HEADER)
    for outcome in outcomes:
        output.write(_row(outcome))
        output.flush()
        yield outcome


def _row(outcome: Outcome) -> str:
    duration, length = "", ""
    if isinstance(outcome.answer, Plan):
        duration = f"{outcome.answer.trajectory.duration_s:.3f}"
        length = f"{path_length_rad(outcome.answer.trajectory):.3f}"
    cpu = f"{1000.0 * outcome.cpu_s:.1f}"
    row = _ROW.format(outcome.asked.id, outcome.code.value, outcome.code.name, cpu, duration, length)
    return row if isinstance(outcome.answer, Plan) else f"{row}    {outcome.answer.message}\n"


def path_length_rad(trajectory: Trajectory) -> float:
    """Length of the path in joint space [rad]."""
    return float(np.linalg.norm(np.diff(trajectory.positions_rad, axis=0), axis=1).sum())


def _write(options: Options, file: ProblemFile, outcomes: Sequence[Outcome]) -> None:
    if options.json_path is not None:
        text = json.dumps(as_json(outcomes, file.joint_names))
        options.json_path.write_text(text + "\n")
    if options.plot_path is not None:
        motions = [(one.asked.id, one.answer.trajectory) for one in outcomes if isinstance(one.answer, Plan)]
        plotting.plot(options.plot_path, motions)


def _answer_as_json(outcome: Outcome, joint_names: Sequence[str]) -> dict[str, Any]:
    answer = outcome.answer
    if isinstance(answer, PlanningFailure):
        return {"problem": outcome.asked.id, "error_code": answer.code.value, "message": answer.message}
    motion = answer.trajectory
    columns = [motion.joint_names.index(name) for name in joint_names if name in motion.joint_names]
    return {
        "problem": outcome.asked.id,
        "time_from_start": motion.time_s.tolist(),
        "positions": motion.positions_rad[:, columns].tolist(),
        "velocities": motion.velocities_rad_s[:, columns].tolist(),
        "accelerations": motion.accelerations_rad_s2[:, columns].tolist(),
    }
