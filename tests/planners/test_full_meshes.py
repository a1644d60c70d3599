"""The plans of the shared problems before an independent judge with the official meshes, and the judge itself."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from harness.full_meshes import Judge
from planners.files import plan_command, problem_file
from planners.files.plan_command import Options
from tests.helpers import resources
from tests.helpers.robots import so101

# Of each list of a file, every so manieth problem: all of them are the benchmark's.
SHARE = 12
SCENES = ("attached", "base_box", "empty", "pillars", "table")
SCENES_OF_BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "scenes"

# A start that overlaps an object in the arm's hulls and parts but not in its meshes, with a goal 3 cm above the tip, as
# the judge takes long for a way through the gap; a goal between shelves that few of the configurations in reach of it
# have free.
HARD = (("gap", "gap-p07", {"position": [0.115, -0.035, 0.072]}), ("shelf", "shelf-p09", {}))
LISTS = ("joint_problems", "position_problems", "infeasible")


@cache
def judged(name: str):
    folder = SCENES_OF_BENCHMARK if name == "near_contacts" else resources.shared_data() / "planning_problems"
    path = folder / f"{name}.json"
    fields = json.loads(path.read_text())
    return path, fields, Judge(resources.shared_data(), fields)


def planned(path: Path, ids: tuple[str, ...] = ()):
    """Plan problems of a file and check that each ends as the file expects; return the answers as JSON."""
    file = problem_file.read(path, so101())
    outcomes = list(plan_command.plan_all(file, plan_command.chosen(file, Options([path], ids=ids))))
    assert {outcome.file_problem.id: outcome.code.name for outcome in outcomes if not outcome.expected} == {}
    return [plan_command.as_json(outcome, file.joint_names) for outcome in outcomes]


def straight(start, goal, duration_s: float):
    """A motion on a line, from rest to rest, as the command writes it."""
    s = np.linspace(0.0, 1.0, 101)[:, np.newaxis]
    start, away = np.array(start), np.array(goal) - np.array(start)
    return {
        "time_from_start": (s[:, 0] * duration_s).tolist(),
        "positions": (start + away * (3.0 * s**2 - 2.0 * s**3)).tolist(),
        "velocities": (away * 6.0 * (s - s**2) / duration_s).tolist(),
        "accelerations": (away * (6.0 - 12.0 * s) / duration_s**2).tolist(),
    }


@pytest.mark.parametrize(("name", "problem", "change"), HARD)
def test_hard_problems_of_the_benchmark_are_solved_and_valid(
    tmp_path: Path, name: str, problem: str, change: dict[str, list[float]]
) -> None:
    fields = json.loads((SCENES_OF_BENCHMARK / f"{name}.json").read_text())
    (entry,) = (entry | change for entry in fields["position_problems"] if entry["id"] == problem)
    path = tmp_path / "hard.json"
    path.write_text(json.dumps({**fields, "joint_problems": [], "infeasible": [], "position_problems": [entry]}))
    (answer,) = planned(path)
    assert not Judge(resources.shared_data(), fields).faults(entry, answer)


@pytest.mark.parametrize("name", [*SCENES, "near_contacts"])
def test_a_share_of_the_shared_problems_is_planned_and_valid(name: str) -> None:
    path, fields, judge = judged(name)
    entries = {entry["id"]: entry for key in LISTS for entry in fields.get(key, ())[::SHARE]}
    answers = [answer for answer in planned(path, tuple(entries)) if "positions" in answer]
    faults = {answer["problem"]: judge.faults(entries[answer["problem"]], answer) for answer in answers}
    assert not {name: found for name, found in faults.items() if found}


def test_the_judge_finds_what_is_wrong_with_a_line() -> None:
    _, fields, judge = judged("empty")
    asked = fields["joint_problems"][0]
    for change, duration_s, words in (
        ({}, 3.0, ""),
        ({}, 0.8, "acceleration limit"),
        ({"goal": [0.0] * 5}, 3.0, "does not end in the goal"),
        ({"start": [0.0] * 5}, 3.0, "does not start at the start"),
    ):
        faults = judge.faults({**asked, **change}, straight(asked["start"], asked["goal"], duration_s))
        assert any(words in fault for fault in faults) == bool(words), words
    for _, fields, judge in map(judged, SCENES):
        asked = next((entry for entry in fields["joint_problems"] if not entry["direct_valid"]), None)
        if asked is not None:
            faults = judge.faults(asked, straight(asked["start"], asked["goal"], 3.0))
            assert any(fault.startswith("touches") for fault in faults)
