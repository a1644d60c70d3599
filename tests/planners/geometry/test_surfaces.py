from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from planners.errors import ShapeError
from planners.files import plan_command, problem_file
from planners.files.plan_command import Options
from planners.geometry import surfaces
from planners.geometry.collision import Closeness, CollisionModel
from planners.geometry.contacts import nearer_than, parts_of, parts_of_surface
from planners.geometry.plain_urdf import kinematic_urdf
from planners.geometry.shapes import triangle_tree
from robot.description.model import LinkSurface
from tests.helpers.full_meshes import Judge
from tests.helpers.meshes import ball
from tests.helpers.resources import in_proportion

# Every so manieth problem of the file: all of them are the benchmark's.
SHARE = 4
NEAR_CONTACTS = Path(__file__).parents[3] / "benchmarks" / "scenes" / "near_contacts.json"


# Circles of the balls in each direction.
AROUND = 60


@pytest.fixture(scope="module")
def pieces():
    vertices, triangles = surfaces.packed(*ball(0.05, AROUND))
    return surfaces.Pieces(surfaces.UNIT_M * vertices, triangles)


def whole(vertices, triangles):
    """A surface as one tree."""
    return parts_of([pin.GeometryObject("surface", 0, pin.SE3.Identity(), triangle_tree(vertices, triangles))])


def drawn_places(seed, nearest_m, furthest_m):
    """Places in random directions, turned at random."""
    rng = np.random.default_rng(seed)
    for _ in range(in_proportion(60)):
        away = rng.normal(size=3)
        turn = pin.Quaternion(*rng.normal(size=4)).normalized().matrix()
        yield pin.SE3(turn, rng.uniform(nearest_m, furthest_m) * away / np.linalg.norm(away))


def test_packing_keeps_every_triangle_within_the_accuracy() -> None:
    vertices, triangles = ball(0.05, AROUND)
    packed, numbers = surfaces.packed(vertices, triangles)
    corners = surfaces.UNIT_M * packed[numbers].mean(axis=1)
    expected = vertices[triangles].mean(axis=1)
    area = np.linalg.norm(np.cross(*(vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2))), axis=1)
    for middle in expected[area > 1e-9][::7]:
        assert np.linalg.norm(corners - middle, axis=1).min() <= surfaces.ACCURACY_M


def test_packing_drops_what_is_twice_or_has_no_extent() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 1e-7, 0.0]])
    _, triangles = surfaces.packed(vertices, np.array([[0, 1, 2], [2, 0, 1], [0, 3, 2], [0, 1, 3]]))
    assert len(triangles) == 1


def test_pieces_hold_every_triangle_once_and_lie_in_their_boxes(pieces) -> None:
    trees = list(pieces)
    assert sum(tree.num_tris for tree in trees) == len(pieces._triangles)
    assert max(tree.num_tris for tree in trees) <= surfaces.TRIANGLES_A_PIECE
    for tree, lower, upper in zip(trees, pieces.lower_m, pieces.upper_m, strict=True):
        corners = np.asarray(tree.vertices())
        assert np.all(corners >= lower)
        assert np.all(corners <= upper)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("margin_m", [0.0, 0.002])
def test_pieces_are_near_where_the_whole_surface_is(pieces, seed, margin_m) -> None:
    here, other = pin.SE3.Identity(), whole(*ball(0.03, AROUND))
    as_one, as_pieces, verdicts = whole(pieces._vertices_m, pieces._triangles), parts_of_surface(pieces), set()
    for at in drawn_places(seed, 0.076, 0.084):
        expected = nearer_than(as_one, here, other, at, margin_m)
        assert nearer_than(as_pieces, here, other, at, margin_m) == expected
        assert nearer_than(other, at, as_pieces, here, margin_m) == expected
        verdicts.add(expected)
    assert verdicts == {True, False}


@pytest.mark.parametrize("seed", range(4))
def test_surfaces_of_two_links_are_near_where_any_of_their_pieces_are(pieces, seed) -> None:
    here = pin.SE3.Identity()
    as_one, as_pieces, verdicts = whole(pieces._vertices_m, pieces._triangles), parts_of_surface(pieces), set()
    for at in drawn_places(seed, 0.098, 0.102):
        expected = nearer_than(as_one, here, as_one, at, 0.0)
        assert nearer_than(as_pieces, here, as_pieces, at, 0.0) == expected
        verdicts.add(expected)
    assert verdicts == {True, False}


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
        list(surfaces.load({"boom": LinkSurface(path, "boom")}, pin_model))
    assert str(path) in str(error.value)


def test_goals_next_to_things_are_answered_as_the_meshes_say(robot, shared_data) -> None:
    file, fields = problem_file.read(NEAR_CONTACTS, robot), json.loads(NEAR_CONTACTS.read_text())
    entries = {one["id"]: one for key in ("joint_problems", "infeasible") for one in fields[key][::SHARE]}
    outcomes = list(
        plan_command.plan_all(file, plan_command.chosen(file, Options([NEAR_CONTACTS], ids=tuple(entries))))
    )
    assert not {outcome.asked.id: outcome.code.name for outcome in outcomes if not outcome.expected}
    judge = Judge(shared_data, fields)
    for answer in plan_command.as_json(outcomes, file.joint_names):
        if "positions" in answer:
            assert not judge.faults(entries[answer["problem"]], answer)


def test_some_goals_next_to_things_are_free_by_surfaces_only(robot) -> None:
    file, fields = problem_file.read(NEAR_CONTACTS, robot), json.loads(NEAR_CONTACTS.read_text())
    with_surfaces, without = CollisionModel(robot), CollisionModel(replace(robot, surfaces={}))
    verdicts = []
    for collision in (with_surfaces, without):
        collision.set_scene(file.scene)
        columns = [collision.joint_names.index(name) for name in fields["joint_names"]]
        q = np.zeros(len(collision.joint_names))
        q[collision.joint_names.index("gripper")] = fields["gripper"]
        for problem in fields["joint_problems"][:20]:
            q[columns] = problem["goal"]
            verdicts.append((collision is with_surfaces, collision.collides(q), collision.collides(q, Closeness.PARTS)))
    assert set(verdicts) == {(True, False, True), (False, True, True)}
