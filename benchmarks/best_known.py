"""Note the best known durations: ``python -m benchmarks.best_known``, changes ``benchmarks/scenes/*.json``.

Plans every joint problem of the benchmark's own scenes with several seeds and much time, and keeps the shortest motion
that passes the check with the official meshes; a shorter duration noted earlier stays. Needs the reference data beside
the checkout.
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.make_scenes import SCENES
from harness.full_meshes import Judge
from harness.server import REFERENCE
from planners.files import plan_command, problem_file
from planners.files.plan_command import Options, Outcome
from planners.problem import Plan
from robot.description.robot_folder import built_in

SEEDS = range(100, 104)
OPTIMIZATION_S = 0.5
ALLOWED_TIME_S = 10.0


def note(path: Path) -> None:
    """Update the durations of one file."""
    fields = json.loads(path.read_text())
    entries = {entry["id"]: entry for entry in fields["joint_problems"]}
    judge = Judge(REFERENCE, fields)
    for seed in SEEDS:
        for outcome in _outcomes(path, tuple(entries), seed):
            entry = entries[outcome.file_problem.id]
            (answer,) = plan_command.as_json([outcome], fields["joint_names"])
            if isinstance(outcome.answer, Plan) and not judge.faults(entry, answer):
                duration_s = round(outcome.answer.trajectory.duration_s, 4)
                entry["best_known_duration"] = min(duration_s, entry.get("best_known_duration", duration_s))
    path.write_text(json.dumps(fields) + "\n")


def _outcomes(path: Path, ids: tuple[str, ...], seed: int) -> list[Outcome]:
    settings = {"seed": seed, "optimization_time_s": OPTIMIZATION_S, "allowed_time_s": ALLOWED_TIME_S}
    file = problem_file.read(path, built_in("so101").model)
    return list(plan_command.plan_all(file, plan_command.chosen(file, Options([path], ids=ids, settings=settings))))


def main() -> None:
    """Update every scene of the benchmark's own."""
    for path in sorted(SCENES.glob("*.json")):
        note(path)
        print(f"{path.stem}: noted")


if __name__ == "__main__":
    main()
