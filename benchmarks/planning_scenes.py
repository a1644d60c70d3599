"""Motions among obstacles: validity, success rate, duration, planning time, correctness of refusals.

The scenes are those of the reference data beside the checkout, when it is there, and the benchmark's own. Validity is
judged by the official meshes, which are part of the reference data.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from harness.figures import percentiles, print_table
from harness.full_meshes import Judge
from harness.server import REFERENCE
from planners.files import plan_command, problem_file
from planners.files.plan_command import Outcome
from planners.motions.motion import STRAIGHT_LINE
from planners.problem import Plan
from robot.description.robot_folder import built_in

SCENES = Path(__file__).parent / "scenes"

# A feasible problem counts as solved within this time.
ALLOWED_TIME_S = 1.0
LONG_OPTIMIZATION_S = 0.06

NEAR_CONTACTS = "near_contacts"  # goals at which hulls touch: a file of their own, of straight lines and refusals


@dataclass(frozen=True)
class Measured:
    """One problem, its answer, and the verdict of the mesh check."""

    fields: dict[str, Any]  # problem as in the file
    mesh: bool  # True if a mesh is among the obstacles
    outcome: Outcome  # armbridge's answer
    faults: list[str] | None  # violations of the motion; None without a motion, or without the official meshes

    @property
    def kind(self) -> str:
        """Return the row of the table to which the problem belongs."""
        if self.outcome.file_problem.id.startswith(NEAR_CONTACTS):
            return "near"
        if not isinstance(self.outcome.answer, Plan):
            return "refused"
        if self.outcome.answer.method == STRAIGHT_LINE:
            return "straight"
        return "mesh" if self.mesh else "planned"

    @property
    def duration_ratio(self) -> float | None:
        """Return the ratio of the duration to the best known one, or None if none is known."""
        best_s = self.fields.get("best_known_duration")
        if best_s is None or not isinstance(self.outcome.answer, Plan):
            return None
        return float(self.outcome.answer.trajectory.duration_s / best_s)


def run() -> None:
    """Measure every scene and print the tables."""
    paths = scene_files()
    if not REFERENCE.is_dir():
        print("no reference data beside the checkout: its scenes and the judgement by the official meshes are left out")
    default, first, longer = list[Measured](), list[Measured](), list[Measured]()
    for path in paths:
        default += measure(path, {})
        first += measure(path, {"optimization_time_s": 0.0})
        longer += measure(path, {"optimization_time_s": LONG_OPTIMIZATION_S})
    for one in (*default, *first, *longer):
        if one.faults or not one.outcome.expected:
            print(f"{one.outcome.file_problem.id}: {one.outcome.code.name} {'; '.join(one.faults or [])}")
    print_table(f"Motions in {len(paths)} scenes", ["", "problems", "goal", "measured"], _rows(default, first, longer))


def scene_files() -> list[Path]:
    """Return every problem file."""
    return [*sorted((REFERENCE / "planning_problems").glob("*.json")), *sorted(SCENES.glob("*.json"))]


def measure(path: Path, settings: dict[str, Any]) -> Iterator[Measured]:
    """Plan every problem of a file and check the motions."""
    fields = json.loads(path.read_text())
    entries = {entry["id"]: entry for key in _LISTS for entry in fields.get(key, [])}
    mesh = any(thing.get("type") == "mesh" for thing in fields["objects"])
    judge = _judge(path) if REFERENCE.is_dir() else None
    file = problem_file.read(path, built_in("so101").model)
    options = plan_command.Options([path], every=True, settings={"allowed_time_s": ALLOWED_TIME_S, **settings})
    for outcome in plan_command.plan_all(file, plan_command.chosen(file, options)):
        entry = entries[outcome.file_problem.id]
        answer = plan_command.as_json(outcome, file.joint_names)
        faults = judge.faults(entry, answer) if judge is not None and "positions" in answer else None
        yield Measured(entry, mesh, outcome, faults)


_LISTS = ("joint_problems", "position_problems", "infeasible")


def _rows(default: Sequence[Measured], first: Sequence[Measured], longer: Sequence[Measured]) -> Iterator[list[str]]:
    judged = [one for one in (*default, *first, *longer) if one.faults is not None]
    yield _share("valid under the official meshes", judged, lambda one: not one.faults, "100 %")
    feasible = [one for one in default if one.outcome.file_problem.feasible]
    yield _share("feasible, solved within 1 s", feasible, lambda one: one.outcome.expected, ">= 99.5 %")
    infeasible = [one for one in default if not one.outcome.file_problem.feasible]
    yield _share("infeasible, right code", infeasible, lambda one: one.outcome.expected, "100 %")
    yield _cpu("straight line", default, "straight", (50, 99), "2 / 5")
    yield _cpu("planned among primitives", default, "planned", (50, 95, 99), "10 / 40 / 80")
    yield _cpu("the same, the first motion found, not shortened", first, "planned", (50, 95, 99), "10 / 40 / 80")
    yield _cpu("planned among meshes", default, "mesh", (50, 95, 99), "40 / 80 / 120")
    yield _cpu("the same, the first motion found, not shortened", first, "mesh", (50, 95, 99), "40 / 80 / 120")
    yield _cpu("refused", default, "refused", (50, 99), "")
    yield _cpu("goals next to things", default, "near", (50, 95, 99), "")
    yield _durations("by default", default, "1.03")
    yield _durations("not shortened", first, "")
    yield _durations("with 60 ms", longer, "1.03")
    yield _durations("straight lines", [one for one in default if one.kind == "straight"], "1.00")


def _share(name: str, of: Sequence[Measured], holds: Callable[[Measured], bool], goal: str) -> list[str]:
    count = sum(map(holds, of))
    return [name, str(len(of)), goal, f"{100.0 * count / max(1, len(of)):.1f} % ({len(of) - count} not)"]


def _cpu(name: str, measured: Sequence[Measured], kind: str, shares: Iterable[int], goal: str) -> list[str]:
    times_s = [one.outcome.cpu_s for one in measured if one.kind == kind]
    label = f"{name}, CPU {' / '.join(f'p{share}' for share in shares)} [ms]"
    return [label, str(len(times_s)), goal, " / ".join(percentiles(times_s, *shares, digits=1))]


def _durations(name: str, measured: Sequence[Measured], goal: str) -> list[str]:
    ratios = [one.duration_ratio for one in measured]
    known = [ratio for ratio in ratios if ratio is not None]
    mean = f"{np.mean(known):.3f}" if known else "-"
    return [f"duration over best known, mean, {name}", str(len(known)), goal, mean]


@cache
def _judge(path: Path) -> Judge:
    return Judge(REFERENCE, json.loads(path.read_text()))
