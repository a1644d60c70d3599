"""``python -m tests.processes.campaign``: run seeds, print a table and every seed with a violation."""

import argparse
import asyncio
import multiprocessing
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from harness.figures import print_table
from robot.emulator.populations import POPULATIONS
from tests.processes.campaign.arm_run import run_arm
from tests.processes.campaign.scenario import Happening, Result, scenario_of

SEEDS = 200

# A run waits most of its time; this many keep two cores busy without delaying each other's ticks much.
JOBS = 6


def main() -> int:
    """Run the campaign; the exit code is 0 if no run has a violation."""
    parser = argparse.ArgumentParser(prog="python -m tests.processes.campaign", description=main.__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"how many seeds (default {SEEDS})")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first of them (default 0)")
    parser.add_argument("--seed", type=int, metavar="SEED", help="this one alone")
    parser.add_argument(
        "--population", choices=POPULATIONS, help="state in which the servos are found (default: drawn by the seed)"
    )
    parser.add_argument("--jobs", type=int, default=JOBS, metavar="N", help=f"runs at a time (default {JOBS})")
    parser.add_argument("--logs", type=Path, metavar="FOLDER", help="keep the logs of all writes there")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds) if options.seed is None else [options.seed]
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.logs or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        results = _run_all(seeds, folder, options.jobs, options.population)
    _report(results)
    return 1 if any(result.violations for result in results) else 0


def run_seed(seed: int, folder: Path, population: str | None = None) -> Result:
    """Run one seed; an error of the run itself counts as a violation.

    Args:
        seed: number of the run.
        folder: takes the log of the servos.
        population: state in which the servos are found; None for the one that the seed draws.
    """
    scenario = scenario_of(seed, population)
    try:
        return asyncio.run(run_arm(scenario, folder))
    except Exception as error:  # noqa: BLE001 - whatever it was, the other seeds go on and this one is named
        violations = [f"the run broke off: {error!r}"]
        return Result(seed, scenario.happening.value, scenario.population, violations=violations)


def _run_all(seeds: Iterable[int], folder: Path, jobs: int, population: str | None) -> list[Result]:
    results = []
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        running = [pool.submit(run_seed, seed, folder, population) for seed in seeds]
        for done in as_completed(running):
            result = done.result()
            results.append(result)
            verdict = "; ".join(result.violations[:3]) or "good"
            print(f"seed {result.seed} ({result.happening}, {result.population}): {verdict}", file=sys.stderr)
    return sorted(results, key=lambda result: result.seed)


def _report(results: list[Result]) -> None:
    names = [*(happening.value for happening in Happening), *POPULATIONS]
    rows = [_row(name, results) for name in names]
    header = ["what happens, and servos", "runs", "motions", "faults told", "writes checked", "runs with violations"]
    print_table("Fault campaign", header, [row for row in rows if row[1] != "0"])
    for result in results:
        for violation in result.violations:
            print(f"seed {result.seed} ({result.happening}, {result.population}): {violation}")
        if result.violations:
            print(f'    again: make campaign ARGS="--seed {result.seed} --population {result.population}"')


def _row(name: str, results: list[Result]) -> list[str]:
    runs = [result for result in results if name in (result.happening, result.population)]
    return [
        name,
        str(len(runs)),
        str(sum(sum(result.outcomes.values()) for result in runs)),
        ", ".join(sorted(set().union(*(result.faults for result in runs)))) or "-",
        str(sum(result.writes for result in runs)),
        str(sum(bool(result.violations) for result in runs)),
    ]


if __name__ == "__main__":
    sys.exit(main())
