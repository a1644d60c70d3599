import json
from pathlib import Path

import pytest

from server import cli


def test_plan_answers_a_file_with_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = {"id": "a", "start": [0.0] * 5, "goal": [0.1] * 5}
    joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    fields = {"format": "so101-plan-bench/1", "name": "n", "joint_names": joints, "joint_problems": [problem]}
    path = tmp_path / "problem.json"
    path.write_text(json.dumps(fields))
    assert cli.main(["plan", str(path), "--seed", "3"]) == 0
    assert "SUCCESS" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--urdf", "a.urdf"], "--urdf and --srdf must be given together"),
        (["--urdf", "/nowhere.urdf", "--srdf", "/nowhere.srdf"], "cannot be read"),
        ([], "/nowhere.json: cannot be read"),
    ],
)
def test_bad_input_of_plan_is_one_line(options: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["plan", "/nowhere.json", *options]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert words in said
