from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from harness.full_meshes import Judge
from planners.errors import ShapeError
from planners.files import plan_command, problem_file
from planners.files.plan_command import Options
from planners.geometry import surfaces
from planners.geometry.shapes import kinematic_urdf
from robot.description.model import LinkSurface

# Every so manieth problem of the file: all of them are the benchmark's.
SHARE = 4
NEAR_CONTACTS = Path(__file__).parents[3] / "benchmarks" / "scenes" / "near_contacts.json"


def test_packing_drops_what_is_twice_or_has_no_extent() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 1e-7, 0.0]])
    _, triangles = surfaces.packed(vertices, np.array([[0, 1, 2], [2, 0, 1], [0, 3, 2], [0, 1, 3]]))
    assert len(triangles) == 1


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "cannot be read"),
        ({"other.vertices": np.zeros((3, 3), np.int16)}, "cannot be read"),
        ({"boom.vertices": np.zeros((3, 3), np.int16), "boom.triangles": np.zeros((0, 3), np.int32)}, "shape (n, 3)"),
        ({"boom.vertices": np.zeros((3, 2), np.int16), "boom.triangles": np.zeros((1, 3), np.int32)}, "shape (n, 3)"),
        (
            {"boom.vertices": np.zeros((3, 3), np.int16), "boom.triangles": np.full((1, 3), 3, np.int32)},
            "without vertices",
        ),
    ],
)
def test_a_file_that_is_none_of_surfaces_is_named(tmp_path, robot, content, problem) -> None:
    path = tmp_path / "surfaces.npz"
    if content is None:
        path.write_text("no numbers")
    else:
        np.savez(path, **content)
    pin_model = pin.buildModelFromXML(kinematic_urdf(robot))
    with pytest.raises(ShapeError, match=problem.replace("(", r"\(").replace(")", r"\)")) as error:
        list(surfaces.load_surfaces({"boom": LinkSurface(path, "boom")}, pin_model))
    assert str(path) in str(error.value)


def test_goals_next_to_things_are_free_by_the_parts_or_refused_as_the_meshes_say(robot, shared_data) -> None:
    file, fields = problem_file.read(NEAR_CONTACTS, robot), json.loads(NEAR_CONTACTS.read_text())
    entries = {one["id"]: one for key in ("joint_problems", "infeasible") for one in fields[key][::SHARE]}
    outcomes = list(
        plan_command.plan_all(file, plan_command.chosen(file, Options([NEAR_CONTACTS], ids=tuple(entries))))
    )
    assert not {outcome.file_problem.id: outcome.code.name for outcome in outcomes if not outcome.expected}
    judge = Judge(shared_data, fields)
    for answer in [plan_command.as_json(outcome, file.joint_names) for outcome in outcomes]:
        if "positions" in answer:
            assert not judge.faults(entries[answer["problem"]], answer)
