from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "server.cli"]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_plan_has_its_own_help() -> None:
    answer = run("plan", "--help")
    assert answer.returncode == 0
    for option in ("--all", "--id", "--json", "--plot", "--urdf", "--srdf", "--time", "--optimize", "--seed"):
        assert option in answer.stdout


def test_plan_answers_a_file_with_a_table(tmp_path: Path) -> None:
    problem = {"id": "a", "start": [0.0] * 5, "goal": [0.1] * 5}
    joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    fields = {"format": "so101-plan-bench/1", "name": "n", "joint_names": joints, "joint_problems": [problem]}
    path = tmp_path / "problem.json"
    path.write_text(json.dumps(fields))
    answer = run("plan", str(path), "--seed", "3")
    assert answer.returncode == 0
    assert "SUCCESS" in answer.stdout


PLAN_USAGE = {
    "urdf alone": (["--urdf", "a.urdf"], "--urdf and --srdf must be given together"),
    "missing description": (["--urdf", "/nowhere.urdf", "--srdf", "/nowhere.srdf"], "cannot be read"),
    "missing problems": ([], "/nowhere.json: cannot be read"),
}


@pytest.mark.parametrize(("options", "words"), PLAN_USAGE.values(), ids=PLAN_USAGE.keys())
def test_what_plan_cannot_use_is_one_line_and_exit_2(options: list[str], words: str) -> None:
    answer = run("plan", "/nowhere.json", *options)
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1
    assert words in answer.stderr
