from __future__ import annotations

from pathlib import Path

import pytest

from robot.description.robot_file import MAX_BYTES, read
from robot.errors import RobotFileError


def problems(folder: Path, text: str) -> tuple[str, ...]:
    path = folder / "robot.toml"
    path.write_text(text)
    with pytest.raises(RobotFileError) as refused:
        read(path)
    return refused.value.problems


def test_an_empty_file_describes_an_ideal_arm_without_a_gripper(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text("")
    file = read(tmp_path / "robot.toml")
    assert (file.hardware.kind, file.gripper, file.hardware.servos) == ("ideal", None, ())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[robot]\nurd = "x"', "robot.urd: there is no such key; did you mean urdf?"),
        ("[joints.a]\nmax_velocty = 2", "joints.a.max_velocty: there is no such key; did you mean max_velocity?"),
        ("[hardwear]", "hardwear: there is no such key; did you mean hardware?"),
        ("[gripper]\njoints = ['a']\nopen = 1", "gripper.closed: is missing"),
        ("[held_joints]\na = 'up'", "held_joints.a: input should be a valid number"),
        (
            "[hardware]\nkind = 'feetec'",
            "hardware.kind: input should be 'feetech', 'dynamixel' or 'ideal', not",
        ),
        ("[hardware]\nkind = 'feetech'", 'hardware: the kind "feetech" needs its table [[hardware.servos]]'),
        ("[joints.a]\nmax_velocity = 0", "joints.a.max_velocity: input should be greater than 0, not 0"),
        (
            "[hardware]\n[[hardware.servos]]\njoint = 'a'\nid = 1\nmodel = 'x'",
            'hardware: the kind "ideal" has no servos',
        ),
        ("[robot", "is no TOML"),
        ("x = 'ü'".encode("latin-1").decode("latin-1") + "#" * MAX_BYTES, f"has more than {MAX_BYTES} bytes"),
    ],
)
def test_a_wrong_key_or_value_is_named(tmp_path: Path, text: str, sentence: str) -> None:
    assert any(problem.startswith(sentence) for problem in problems(tmp_path, text)), problems(tmp_path, text)


@pytest.mark.parametrize(("key", "first", "second"), [("id", "7", "7"), ("joint", "'a'", "'a'")])
def test_two_servos_of_one_id_or_joint_are_named(tmp_path: Path, key: str, first: str, second: str) -> None:
    rows = [{"joint": "'a'", "id": "1"}, {"joint": "'b'", "id": "2"}]
    rows[0][key], rows[1][key] = first, second
    servos = "".join(f"[[hardware.servos]]\njoint = {row['joint']}\nid = {row['id']}\nmodel = 'x'\n" for row in rows)
    (problem,) = problems(tmp_path, f"[hardware]\nkind = 'feetech'\n{servos}")
    assert f"servos[1].{key} {first} stands at servos[0] as well" in problem


def test_everything_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    assert len(problems(tmp_path, "[robot]\nurd = 'x'\n[gripper]\nopen = 1\n[joints.a]\nmax_jerk = -1")) == 4


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match=r"robot\.toml cannot be read"):
        read(tmp_path / "robot.toml")
