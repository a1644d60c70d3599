"""``armbridge plan``: plan the problems of files without a server, print a table, and plot the motions."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import json
import logging
import pickle
import re
import threading
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import metadata, resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from planners.errors import BatchError, PlannerError, PlottingError, ProblemFileError
from planners.files import problem_file
from planners.files.problem_file import FileProblem, ProblemFile
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import Scene
from robot.description.model import RobotModel
from robot.trajectory import Trajectory

if TYPE_CHECKING:
    from distributed import Client, Future

MAX_MOTIONS = 20  # as many rows as one picture can show
POINTS = 400  # points a curve is drawn with
ROW_SIZE_IN = (12.0, 2.6)  # inches of a row, wide and high

# Exit codes: every answer is accepted by its file; some are not; nothing was planned.
EXIT_EXPECTED = 0
EXIT_UNEXPECTED = 3
EXIT_USAGE = 2

_ROW = "{:<{}} {:>5}  {:<26} {:>8}  {:>12}  {:>12}\n"
_TITLES = ("code", "", "CPU [ms]", "duration [s]", "length [rad]")
_NAME_WIDTH = 20

_CLEAR_LINE = "\r\x1b[K"  # back to the begin of the line, and clear it (ECMA-48)


def check_available() -> None:
    """Raise a PlottingError if pictures cannot be drawn because matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise PlottingError("plots need matplotlib; install it with: pip install matplotlib")


def plot(path: Path, motions: Sequence[tuple[str, Trajectory]]) -> None:
    """Draw the first :data:`MAX_MOTIONS` motions, each with its name; PlottingError: no motion, or no such picture."""
    # Loaded when something is drawn: it takes a quarter of a second.
    from matplotlib.figure import Figure

    drawn = motions[:MAX_MOTIONS]
    if not drawn:
        raise PlottingError("there is no motion to plot")
    width_in, height_in = ROW_SIZE_IN
    figure = Figure(figsize=(width_in, height_in * len(drawn)), layout="constrained")
    rows = figure.subplots(len(drawn), 2, squeeze=False)
    for (positions, velocities), (name, motion) in zip(rows, drawn, strict=True):
        times_s = np.linspace(0.0, motion.duration_s, POINTS)
        samples = [motion.sample(time_s) for time_s in times_s]
        positions.plot(times_s, [sample[0] for sample in samples], label=motion.joint_names)
        velocities.plot(times_s, [sample[1] for sample in samples])
        positions.set(title=name, xlabel="time [s]", ylabel="position [rad]")
        velocities.set(title=name, xlabel="time [s]", ylabel="velocity [rad/s]")
    rows[0][0].legend(fontsize="small")
    try:
        figure.savefig(path)
    except ValueError as error:
        raise PlottingError(f"{path} cannot be drawn: {error}") from error


@dataclass(frozen=True)
class Options:
    """Options of the command."""

    paths: Sequence[Path]  # the problem files
    every: bool = False  # whether the infeasible problems are planned as well
    ids: tuple[str, ...] = ()  # the problems to plan, whatever file and list they are in; empty for all feasible ones
    json_path: Path | None = None  # where the answers go as JSON, or None
    plot_path: Path | None = None  # where the plot of the motions goes, or None
    # Fields of PlanningProblem that hold for every problem, whatever the files say.
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    scheduler: str | None = None  # address of the Dask scheduler whose workers plan; None to plan here


@dataclass(frozen=True)
class Task:
    """One problem to plan."""

    name: str  # its id, after the path of its file when there are several
    path: Path
    file: ProblemFile
    file_problem: FileProblem


@dataclass(frozen=True)
class Outcome:
    """Outcome of one problem."""

    file_problem: FileProblem
    answer: Plan | PlanningFailure
    cpu_s: float  # CPU time spent on it [s]

    @property
    def code(self) -> MoveItErrorCode:
        """The value of moveit_msgs/MoveItErrorCodes that a server would answer."""
        return self.answer.code if isinstance(self.answer, PlanningFailure) else MoveItErrorCode.SUCCESS

    @property
    def expected(self) -> bool:
        """True when the file accepts the answer, or a saved failure fails again in the same way."""
        return self.code in self.file_problem.accept_codes or self.failed_as_before

    @property
    def failed_as_before(self) -> bool:
        """True when a failure that a server saved has the same error code here."""
        return self.code == self.file_problem.answered_code != MoveItErrorCode.SUCCESS


def run(options: Options, robot: RobotModel, output: TextIO, errors: TextIO) -> int:
    """Plan, print a table, and write the requested files; return the exit code."""
    try:
        if options.plot_path is not None:
            check_available()
        tasks = _tasks(options, robot)
        # Closed in any case, so that a cluster does not go on with problems whose answers are not needed.
        with contextlib.closing(_answers(tasks, options.scheduler)) as answers:
            outcomes = _printed(tasks, answers, output, errors)
        _write(options, tasks, outcomes)
    except (PlannerError, OSError) as error:
        errors.write(f"armbridge: {error}\n")
        return EXIT_USAGE
    wrong = sum(not outcome.expected for outcome in outcomes)
    expecting = "the file expects" if len(options.paths) == 1 else "their files expect"
    output.write(f"{len(outcomes) - wrong} of {len(outcomes)} answered as {expecting}\n")
    if again := sum(outcome.failed_as_before for outcome in outcomes):
        output.write(f"{again} of them failed as on the server that saved the problem\n")
    return EXIT_UNEXPECTED if wrong else EXIT_EXPECTED


def chosen(file: ProblemFile, options: Options) -> list[FileProblem]:
    """The problems of a file to plan, with the settings of the command line."""
    if options.ids:
        known = {problem.id: problem for problem in file.problems}
        wanted = [known[name] for name in options.ids if name in known]
    else:
        wanted = [problem for problem in file.problems if options.every or problem.feasible]
    return [dataclasses.replace(one, problem=dataclasses.replace(one.problem, **options.settings)) for one in wanted]


def plan_all(file: ProblemFile, problems: Sequence[FileProblem]) -> Iterator[Outcome]:
    """Plan problems of a file, one after the other; ShapeError: the robot's collision shapes cannot be used."""
    # As in a server's planner process: a goal that failed there fails in the same way here, however busy the machine.
    planner = Planner(file.robot, time.process_time)
    refusal = planner.set_scene(file.scene)
    for file_problem in problems:
        started_s = time.process_time()
        answer = refusal or planner.plan(file_problem.problem)
        yield Outcome(file_problem, answer, time.process_time() - started_s)


def _tasks(options: Options, robot: RobotModel) -> list[Task]:
    files = [problem_file.read(path, robot) for path in options.paths]
    known = {problem.id for file in files for problem in file.problems}
    for name in options.ids:
        if name not in known:
            raise ProblemFileError(", ".join(map(str, options.paths)), "id", f"there is no problem {name!r}")
    return [
        Task(file_problem.id if len(files) == 1 else f"{path}:{file_problem.id}", path, file, file_problem)
        for path, file in zip(options.paths, files, strict=True)
        for file_problem in chosen(file, options)
    ]


def _answers(tasks: Sequence[Task], scheduler: str | None) -> Generator[tuple[int, Outcome]]:
    """Plan tasks here or on a cluster; outcomes come with the tasks' numbers, in the order in which they are known."""
    if scheduler is not None:
        planned = plan_on(scheduler, [(task.file, task.file_problem.problem) for task in tasks])
        for number, answer, cpu_s in planned:
            yield number, Outcome(tasks[number].file_problem, answer, cpu_s)
        return
    number = 0
    for _, group in itertools.groupby(tasks, key=lambda task: id(task.file)):
        together = list(group)
        for outcome in plan_all(together[0].file, [task.file_problem for task in together]):
            yield number, outcome
            number += 1


def as_json(outcome: Outcome, joint_names: Sequence[str]) -> dict[str, Any]:
    """Return an answer as plain values, joints in the given order."""
    answer = outcome.answer
    if isinstance(answer, PlanningFailure):
        return {"problem": outcome.file_problem.id, "error_code": answer.code.value, "message": answer.message}
    motion = answer.trajectory
    columns = [motion.joint_names.index(name) for name in joint_names if name in motion.joint_names]
    return {
        "problem": outcome.file_problem.id,
        "time_from_start": motion.time_s.tolist(),
        "positions": motion.positions_rad[:, columns].tolist(),
        "velocities": motion.velocities_rad_s[:, columns].tolist(),
        "accelerations": motion.accelerations_rad_s2[:, columns].tolist(),
    }


def _printed(
    tasks: Sequence[Task], answers: Iterable[tuple[int, Outcome]], output: TextIO, errors: TextIO
) -> list[Outcome]:
    """Print each outcome as it comes, and on a terminal how many there are of how many; return them in tasks' order."""
    width = max([_NAME_WIDTH, *(len(task.name) for task in tasks)])
    clear = _CLEAR_LINE if errors.isatty() else ""
    outcomes: dict[int, Outcome] = {}
    try:
        for number, outcome in answers:
            if not outcomes:
                output.write(_ROW.format("problem", width, *_TITLES))
            outcomes[number] = outcome
            errors.write(clear)
            errors.flush()
            output.write(_row(tasks[number].name, width, outcome))
            output.flush()
            if clear:
                errors.write(f"{len(outcomes)}/{len(tasks)}")
                errors.flush()
    finally:
        errors.write(clear)
    return [outcomes[number] for number in range(len(tasks))]


def _row(name: str, width: int, outcome: Outcome) -> str:
    duration, length = "", ""
    if isinstance(outcome.answer, Plan):
        duration = f"{outcome.answer.trajectory.duration_s:.3f}"
        steps_rad = np.linalg.norm(np.diff(outcome.answer.trajectory.positions_rad, axis=0), axis=1)
        length = f"{steps_rad.sum():.3f}"
    cpu = f"{1000.0 * outcome.cpu_s:.1f}"
    row = _ROW.format(name, width, outcome.code.value, outcome.code.name, cpu, duration, length)
    return row if isinstance(outcome.answer, Plan) else f"{row}    {outcome.answer.message}\n"


def _write(options: Options, tasks: Sequence[Task], outcomes: Sequence[Outcome]) -> None:
    if options.json_path is not None:
        written: list[dict[str, Any]] = []
        for task, outcome in zip(tasks, outcomes, strict=True):
            entry = as_json(outcome, task.file.joint_names)
            written.append(entry if len(options.paths) == 1 else {"file": str(task.path), **entry})
        options.json_path.write_text(json.dumps(written) + "\n")
    if options.plot_path is not None:
        named = zip(tasks, outcomes, strict=True)
        motions = [(task.name, one.answer.trajectory) for task, one in named if isinstance(one.answer, Plan)]
        plot(options.plot_path, motions)


# A scheduler answers within milliseconds, and its workers need seconds to join when they are just starting.
CONNECT_TIMEOUT_S = 5.0

# Planners of a few MB each that a worker keeps: one for each of its threads and each of the last files.
MAX_PLANNERS = 8

# All that is pickled, and all that makes the answers, is defined there.
_SOURCES = (("planners", "**/*.py"), ("robot", "description/*.py"), ("robot", "trajectory.py"))


@dataclass(frozen=True)
class Setup:
    """All that the problems of a file share."""

    digest: str  # of robot and scene, by which setups are distinguished
    robot: RobotModel = field(compare=False)  # the arm to plan for
    scene: Scene = field(compare=False)


def plan_on(
    address: str, problems: Sequence[tuple[ProblemFile, PlanningProblem]]
) -> Iterator[tuple[int, Plan | PlanningFailure, float]]:
    """Plan problems on a Dask cluster; yield number, answer and CPU time [s] of each. BatchError: it cannot."""
    with _connected(address) as client:
        from distributed import CancelledError, as_completed

        _check_workers(client, address)
        # As tasks, and not scattered: a setup that is lost with a worker is made again on another one.
        setups = {id(file): client.submit(pickle.loads, _packed_setup(file), pure=False) for file, _ in problems}
        futures = client.map(
            answer,
            [setups[id(file)] for file, _ in problems],
            # Packed: Dask would search for its own objects inside.
            [pickle.dumps(problem) for _, problem in problems],
            asked_by=version(),
            pure=False,
        )
        numbers = {future.key: number for number, future in enumerate(futures)}
        try:
            for future in as_completed(futures):
                yield numbers[future.key], *_result(future)
        except (CancelledError, OSError) as error:
            raise BatchError(f"the Dask scheduler {address} was lost") from error


def answer(setup: Setup, problem: bytes, asked_by: str) -> tuple[Plan | PlanningFailure, float]:
    """Plan a pickled problem in a Dask worker; return answer and CPU time [s]. BatchError: another armbridge."""
    if asked_by != version():
        raise BatchError("the worker runs another armbridge")
    planner, refusal = _planner(setup, threading.get_ident())
    started_s = time.thread_time()
    planned = refusal or planner.plan(pickle.loads(problem))  # noqa: S301 - of the one whose tasks this worker runs
    return planned, time.thread_time() - started_s


@functools.cache
def version() -> str:
    """Return armbridge's version and a digest of the code of its planners, as in ``0.1.0 (planners 3fa2b1c4)``."""
    digest = hashlib.sha256()
    for package, pattern in _SOURCES:
        with resources.as_file(resources.files(package)) as folder:
            for path in sorted(folder.glob(pattern)):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{metadata.version('armbridge')} (planners {digest.hexdigest()[:8]})"


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """Connect to a scheduler; leaving the context cancels open problems."""
    if find_spec("distributed") is None:
        raise BatchError("--scheduler needs the package distributed: pip install 'armbridge[dask]'")
    if not re.fullmatch(r"(tcp|tls)://[^/@\s]+:\d+", address):
        raise BatchError(f"--scheduler {address}: must be tcp://HOST:PORT or tls://HOST:PORT")
    from distributed import Client

    # It logs pages of tracebacks for each failure; BatchError has what matters. Tornado's logger has the one of an
    # interrupt that meets distributed.utils.sync before its coroutine begins: its cancel() then knows no future.
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        # Dask's own configuration names the certificates of tls://.
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, TypeError, ValueError) as error:
        raise BatchError(f"the Dask scheduler {address} cannot be reached: {error}") from error
    with client:
        yield client


def _check_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
    except TimeoutError as error:
        raise BatchError(f"the Dask scheduler {address} has no workers") from error
    for worker, theirs in client.run(version, on_error="return").items():
        if isinstance(theirs, Exception):
            reason = f"cannot run armbridge: {theirs}"
        elif theirs != version():
            reason = f"runs armbridge {theirs}"
        else:
            continue
        raise BatchError(f"the Dask worker {worker} {reason}; install armbridge {version()} there, as here")


def _packed_setup(file: ProblemFile) -> bytes:
    digest = hashlib.sha256(pickle.dumps((file.robot, file.scene))).hexdigest()
    return pickle.dumps(Setup(digest, file.robot, file.scene))


@functools.lru_cache(maxsize=MAX_PLANNERS)
def _planner(setup: Setup, _thread: int) -> tuple[Planner, PlanningFailure | None]:
    """Make the planner of one thread, whose CPU time counts, and return the flaw of the scene."""
    planner = Planner(setup.robot, time.thread_time)
    return planner, planner.set_scene(setup.scene)


def _result(future: Future[Any]) -> tuple[Plan | PlanningFailure, float]:
    from distributed import KilledWorker

    error = future.exception()
    if error is None:
        planned: tuple[Plan | PlanningFailure, float] = future.result()
        return planned
    if isinstance(error, KilledWorker):
        message = f"{error.allowed_failures + 1} workers ended while they worked on this"
    else:
        message = f"the worker failed: {type(error).__name__}: {error}"
    return PlanningFailure(MoveItErrorCode.CRASH, message), 0.0
