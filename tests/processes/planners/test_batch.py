"""Batches planned by the workers of Dask clusters, each a scheduler and workers on this machine."""

import io
import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from harness.server import free_port
from harness.waiting import TIMEOUT_S, running, wait_until
from planners.errors import BatchError
from planners.files import plan_command, problem_file
from planners.problem import MoveItErrorCode, Plan, PlanningFailure
from tests.helpers.resources import is_open
from tests.helpers.robots import so101

distributed = pytest.importorskip("distributed", reason="the extra [dask] is not installed")

ROOT = Path(__file__).parents[3]
GAP, CLUTTER = (ROOT / "benchmarks" / "scenes" / f"{name}.json" for name in ("gap", "clutter"))

HOST = "127.0.0.1"


class DaskCluster:
    """A scheduler and its workers, by the commands of docs/planning.md; each takes one problem at a time."""

    def __init__(self) -> None:
        self.workers: list[subprocess.Popen[bytes]] = []
        self._start_scheduler()

    def _start_scheduler(self) -> None:
        self._port = free_port()
        self.address = f"tcp://{HOST}:{self._port}"
        self.scheduler = self._start("scheduler", "--port", str(self._port), "--dashboard-address", f"{HOST}:0")
        # Dask's own attempts come further and further apart.
        wait_until(lambda: is_open(self._port))

    def have_workers(self, count: int) -> None:
        """Start what is missing of the scheduler and this number of workers: tests end parts of a cluster."""
        if self.scheduler.poll() is not None:
            self.close()
            self._start_scheduler()
        self.workers = [each for each in self.workers if each.poll() is None]
        while len(self.workers) < count:
            self.workers.append(self._start("worker", self.address, "--nthreads", "1", "--no-nanny"))
        with distributed.Client(self.address, timeout=TIMEOUT_S) as client:
            client.wait_for_workers(count, timeout=TIMEOUT_S)

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait(TIMEOUT_S)

    def _start(self, command: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", command, *arguments, "--host", HOST, "--no-dashboard"],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "critical"},
            stdin=subprocess.DEVNULL,
        )


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for a scheduler however busy the machine is."""
    monkeypatch.setattr(plan_command, "CONNECT_TIMEOUT_S", TIMEOUT_S)


@pytest.fixture(scope="module")
def shared_cluster() -> Iterator[DaskCluster]:
    running = DaskCluster()
    yield running
    running.close()


@pytest.fixture
def cluster(shared_cluster: DaskCluster) -> DaskCluster:
    shared_cluster.have_workers(2)
    return shared_cluster


@pytest.fixture
def empty_cluster() -> Iterator[DaskCluster]:
    running = DaskCluster()
    yield running
    running.close()


def planned(cluster: str | None, *paths: Path, json_path: Path | None = None) -> tuple[int, list[str], list[str]]:
    """What ``armbridge plan`` does in its process: exit code, and the lines of stdout and stderr."""
    output, errors = io.StringIO(), io.StringIO()
    options = plan_command.Options(paths, json_path=json_path, settings={"seed": 3}, scheduler=cluster)
    code = plan_command.run(options, so101(), output, errors)
    return code, output.getvalue().splitlines(), errors.getvalue().splitlines()


def begun(cluster: DaskCluster, lasts_s: float) -> tuple[Iterator[tuple[int, Plan | PlanningFailure, float]], int]:
    """Begin a batch; returns its answers, of which the first has come, and how many still take a time each [s]."""
    file = problem_file.read(GAP, so101())
    feasible = [each.problem for each in file.problems if each.feasible][:4]
    first, *others = (replace(each, allowed_time_s=TIMEOUT_S) for each in feasible)
    problems = [first, *(replace(each, optimization_time_s=lasts_s) for each in others)]
    answers = plan_command.plan_on(cluster.address, [(file, each) for each in problems])
    next(answers)
    return answers, len(problems) - 1


def few(path: Path, folder: Path) -> Path:
    """A file with the first problems of each list of another."""
    fields = json.loads(path.read_text())
    lists = ("joint_problems", "position_problems", "infeasible")
    shorter = folder / path.name
    shorter.write_text(json.dumps(fields | {name: fields[name][:2] for name in lists}))
    return shorter


def test_a_cluster_without_workers_and_a_scheduler_that_does_not_answer_are_named(
    empty_cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan_command, "CONNECT_TIMEOUT_S", 0.1)
    address = empty_cluster.address
    with distributed.Client(address, timeout=TIMEOUT_S) as client, pytest.raises(BatchError) as raised:
        plan_command._check_workers(client, address)
    assert str(raised.value) == f"the Dask scheduler {address} has no workers"
    address = f"tcp://{HOST}:{free_port()}"
    code, lines, (error,) = planned(address, GAP)
    assert (code, lines) == (2, [])
    assert error.startswith(f"armbridge: the Dask scheduler {address} cannot be reached: ")


def test_several_files_are_planned_as_here(cluster: DaskCluster, tmp_path: Path) -> None:
    here, there = tmp_path / "here.json", tmp_path / "there.json"
    files = few(GAP, tmp_path), few(CLUTTER, tmp_path)
    local = planned(None, *files, json_path=here)
    far = planned(cluster.address, *files, json_path=there)
    assert (far[0], far[1][-1], far[2]) == (local[0], local[1][-1], [])
    assert json.loads(there.read_text()) == json.loads(here.read_text())
    assert {line.split()[0] for line in far[1]} == {line.split()[0] for line in local[1]}


@pytest.fixture
def other_version(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The version of this process, which is none of a worker's."""
    monkeypatch.setattr(plan_command, "_SOURCES", ())
    plan_command.version.cache_clear()
    yield plan_command.version()
    plan_command.version.cache_clear()


def test_workers_with_another_armbridge_are_named_with_both_versions(cluster: DaskCluster, other_version: str) -> None:
    with pytest.raises(BatchError) as raised:
        next(plan_command.plan_on(cluster.address, []))
    theirs, ours = str(raised.value).split("; install ")
    assert theirs.startswith("the Dask worker tcp://127.0.0.1:")
    assert "runs armbridge 0." in theirs
    assert ours == f"armbridge {other_version} there, as here"


def test_an_interrupt_takes_back_what_is_not_planned(cluster: DaskCluster) -> None:
    command = [sys.executable, "-m", "server.cli", "plan", GAP, "--optimize", "1", "--scheduler", cluster.address]
    with running(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        # The titles and the first row.
        assert all(process.stdout.readline() for _ in range(2))
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    assert (process.returncode, errors) == (1, "armbridge: stopped before every problem was planned\n")
    with distributed.Client(cluster.address, timeout=TIMEOUT_S) as client:
        assert client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks)) == []


def test_problems_of_a_worker_that_dies_are_planned_by_another(cluster: DaskCluster) -> None:
    answers, open_ = begun(cluster, 1.0)
    cluster.workers[0].kill()
    cluster.workers[0].wait(TIMEOUT_S)
    rest = list(answers)
    assert len(rest) == open_
    assert all(isinstance(answer, Plan) for _, answer, _ in rest)


def test_a_scheduler_that_is_lost_ends_the_batch(cluster: DaskCluster) -> None:
    # The others take longer than this test.
    answers, _ = begun(cluster, 60.0)
    cluster.scheduler.kill()
    cluster.scheduler.wait(TIMEOUT_S)
    with pytest.raises(BatchError, match=f"the Dask scheduler {cluster.address} was lost"):
        list(answers)


def test_a_worker_that_joined_late_with_another_armbridge_plans_nothing() -> None:
    setup = pickle.loads(plan_command._packed_setup(problem_file.read(GAP, so101())))
    with pytest.raises(BatchError, match="another armbridge"):
        plan_command.answer(setup, b"", "0.0.1")


def test_a_worker_keeps_a_planner_for_each_thread_and_file() -> None:
    first, second = (pickle.loads(plan_command._packed_setup(problem_file.read(GAP, so101()))) for _ in range(2))
    other = pickle.loads(plan_command._packed_setup(problem_file.read(CLUTTER, so101())))
    planner, refusal = plan_command._planner(first, 1)
    assert refusal is None
    assert plan_command._planner(plan_command.Setup(first.digest, second.robot, second.scene), 1)[0] is planner
    assert plan_command._planner(first, 2)[0] is not planner
    assert plan_command._planner(other, 1)[0] is not planner


class FailedFuture:
    """A problem that Dask gave up."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def exception(self) -> Exception:
        return self._error


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (distributed.KilledWorker("key", None, 3), "4 workers ended while they worked on this"),
        (ValueError("a bug"), "the worker failed: ValueError: a bug"),
    ],
)
def test_a_problem_that_a_worker_fails_at_is_a_crash(error: Exception, words: str) -> None:
    answer = plan_command._result(FailedFuture(error))
    assert answer == (PlanningFailure(MoveItErrorCode.CRASH, words), 0.0)


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_command, "find_spec", lambda name: None)
    with pytest.raises(BatchError, match=r"pip install 'armbridge\[dask\]'"):
        next(plan_command.plan_on("tcp://127.0.0.1:1", []))


@pytest.mark.parametrize("address", ["127.0.0.1:8786", "http://127.0.0.1:8786", "tcp://127.0.0.1"])
def test_an_invalid_scheduler_address_is_refused(address: str) -> None:
    with pytest.raises(BatchError, match="must be tcp://HOST:PORT or tls://HOST:PORT"):
        next(plan_command.plan_on(address, []))
