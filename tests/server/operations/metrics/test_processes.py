from __future__ import annotations

import os

from server.operations.distribution import Distribution
from server.operations.metrics.processes import build_metrics, loop_metrics, process_metrics
from tests.helpers.metric_samples import samples

NO_PROCESS = 2**22 + 1


def test_each_process_that_runs_is_told_by_what_it_is() -> None:
    found = samples(process_metrics({"arm": os.getppid(), "planner_1": NO_PROCESS}))
    for name in ("resident_memory_bytes", "threads", "open_fds", "cpu_seconds_total"):
        assert found[f"armbridge_process_{name}", "arm"] >= 0
        assert found[f"armbridge_process_{name}", "server"] > 0
    assert len(found) == 8


def test_the_loops_lag_is_a_histogram() -> None:
    lag_s = Distribution((0.1,))
    lag_s.take(0.5)
    found = samples(loop_metrics(lag_s))
    assert found["armbridge_event_loop_lag_seconds_bucket", "+Inf"] == 1


def test_the_version_is_told() -> None:
    assert [name[0] for name in samples(build_metrics())] == ["armbridge_build_info"]
