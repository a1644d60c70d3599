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
from planners.geometry.contacts import nearer_than, parts_of, parts_of_surface, surfaces_nearer_than
from planners.geometry.plain_urdf import kinematic_urdf
from planners.geometry.shapes import triangle_tree
from robot.description.model import LinkSurface
from tests.helpers.full_meshes import Judge
from tests.helpers.resources import in_proportion

# Every so manieth problem of the file: all of them are the benchmark's.
SHARE = 4
NEAR_CONTACTS = Path(__file__).parents[3] / "benchmarks" / "scenes" / "near_contacts.json"


def sphere(radius_m: float, around: int = 60):
    """Vertices and triangles of a ball."""
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, around), np.linspace(0.0, np.pi, around), indexing="ij")
    vertices = radius_m * np.stack((np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)), axis=-1).reshape(-1, 3)
    corner = (np.arange(around - 1)[:, None] * around + np.arange(around - 1)).ravel()
    halves = (corner, corner + 1, corner + around), (corner + 1, corner + around, corner + around + 1)
    return vertices, np.vstack([np.stack(half, axis=1) for half in halves])


@pytest.fixture(scope="module")
def ball():
    vertices, triangles = surfaces.packed(*sphere(0.05))
    return surfaces.Pieces(surfaces.UNIT_M * vertices, triangles)


def test_packing_keeps_every_triangle_within_the_accuracy() -> None:
    vertices, triangles = sphere(0.05)
    packed, numbers = surfaces.packed(vertices, triangles)
    corners = surfaces.UNIT_M * packed[numbers].mean(axis=1)
    expected = vertices[triangles].mean(axis=1)
    area = np.linalg.norm(np.cross(*(vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2))), axis=1)
    for middle in expected[area > 1e-9]:
        assert np.linalg.norm(corners - middle, axis=1).min() <= surfaces.ACCURACY_M


def test_packing_drops_what_is_twice_or_has_no_extent() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 1e-7, 0.0]])
    _, triangles = surfaces.packed(vertices, np.array([[0, 1, 2], [2, 0, 1], [0, 3, 2], [0, 1, 3]]))
    assert len(triangles) == 1


def test_pieces_hold_every_triangle_once_and_lie_in_their_boxes(ball) -> None:
    pieces = list(ball)
    assert sum(piece.num_tris for piece in pieces) == len(ball._triangles)
    assert max(piece.num_tris for piece in pieces) <= surfaces.TRIANGLES_A_PIECE
    for piece, lower, upper in zip(pieces, ball.lower_m, ball.upper_m, strict=True):
        corners = np.asarray(piece.vertices())
        assert np.all(corners >= lower)
        assert np.all(corners <= upper)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("margin_m", [0.0, 0.002])
def test_pieces_are_near_where_the_whole_surface_is(ball, seed, margin_m) -> None:
    whole = parts_of(
        [pin.GeometryObject("ball", 0, pin.SE3.Identity(), triangle_tree(ball._vertices_m, ball._triangles))]
    )
    other = parts_of([pin.GeometryObject("other", 0, pin.SE3.Identity(), triangle_tree(*sphere(0.03)))])
    rng, verdicts = np.random.default_rng(seed), set()
    for _ in range(in_proportion(60)):
        away = rng.normal(size=3)
        at = pin.SE3(
            pin.Quaternion(*rng.normal(size=4)).normalized().matrix(),
            rng.uniform(0.076, 0.084) * away / np.linalg.norm(away),
        )
        expected = nearer_than(whole, pin.SE3.Identity(), other, at, margin_m)
        assert surfaces_nearer_than(parts_of_surface(ball), pin.SE3.Identity(), other, at, margin_m) == expected
        assert surfaces_nearer_than(other, at, parts_of_surface(ball), pin.SE3.Identity(), margin_m) == expected
        verdicts.add(expected)
    assert verdicts == {True, False}


@pytest.mark.parametrize("seed", range(4))
def test_surfaces_of_two_links_are_near_where_any_of_their_pieces_are(ball, seed) -> None:
    whole = parts_of(
        [pin.GeometryObject("ball", 0, pin.SE3.Identity(), triangle_tree(ball._vertices_m, ball._triangles))]
    )
    rng, verdicts = np.random.default_rng(seed), set()
    for _ in range(in_proportion(60)):
        away = rng.normal(size=3)
        at = pin.SE3(
            pin.Quaternion(*rng.normal(size=4)).normalized().matrix(),
            rng.uniform(0.098, 0.102) * away / np.linalg.norm(away),
        )
        expected = nearer_than(whole, pin.SE3.Identity(), whole, at, 0.0)
        assert (
            surfaces_nearer_than(parts_of_surface(ball), pin.SE3.Identity(), parts_of_surface(ball), at, 0.0)
            == expected
        )
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
