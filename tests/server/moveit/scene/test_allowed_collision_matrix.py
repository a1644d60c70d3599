"""The allowed collision matrix."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.errors import RefusedError
from server.moveit.scene.allowed_collision_matrix import (
    MAX_NAMES,
    AllowedCollisionMatrix,
    disabled_collisions,
    read_allowed_collision_matrix,
)
from tests.helpers.moveit import ROBOT, message

OF_ROBOT = AllowedCollisionMatrix.of_robot(ROBOT)
UNCHECKED = disabled_collisions(ROBOT)
NEIGHBOURS, APART = frozenset(("base_link", "shoulder_link")), frozenset(("base_link", "gripper_link"))


def matrix(names, *rows, **defaults):
    told = {
        "entry_names": names,
        "entry_values": [{"enabled": row} for row in rows],
        "default_entry_names": list(defaults),
        "default_entry_values": list(defaults.values()),
    }
    return read_allowed_collision_matrix(message("AllowedCollisionMatrix", **told))


def test_the_robots_own_matrix_names_every_link_and_what_the_srdf_disables():
    told = OF_ROBOT.message
    assert told["entry_names"] == list(ROBOT.links)
    rows = [entry["enabled"] for entry in told["entry_values"]]
    pairs = itertools.product(ROBOT.links, repeat=2)
    allowed = {frozenset(pair) for pair in itertools.compress(pairs, itertools.chain(*rows))}
    assert allowed == ROBOT.disabled_pairs | UNCHECKED


@given(st.lists(st.booleans(), min_size=10, max_size=10))
def test_a_matrix_is_written_as_it_was_read(values):
    names = ["a", "b", "c", "d", "e"]
    rows = [[False] * 5 for _ in names]
    pairs = [(i, j) for i in range(5) for j in range(i)]
    for (i, j), value in zip(pairs, values, strict=True):
        rows[i][j] = rows[j][i] = value
    told = message("AllowedCollisionMatrix", entry_names=names, entry_values=[{"enabled": row} for row in rows])
    assert read_allowed_collision_matrix(told).message == told


def test_pairs_above_the_diagonal_and_those_whose_defaults_both_allow_are_exceptions() -> None:
    rows = [False, True, True], [True, False, False], [True, False, False]
    allowed = matrix(["base_link", "gripper_link", "cup"], *rows)
    assert allowed.exceptions(UNCHECKED, ()) == {APART: True, frozenset(("base_link", "cup")): True}
    forbidden = matrix(["base_link", "shoulder_link"], [False, False], [False, False])
    assert forbidden.exceptions(UNCHECKED, ()) == {NEIGHBOURS: False}
    assert matrix(["a", "b"], [False, True], [False, False]).allowed == {frozenset("ab")}
    assert matrix(["a", "b"], [True, False], [True, True]).allowed == frozenset()
    said = matrix([], cup=True).exceptions(UNCHECKED, ["base_link", "gripper_link", "cup"])
    assert said == {frozenset(("cup", "base_link")): True, frozenset(("cup", "gripper_link")): True}
    assert matrix([], cup=True, base_link=False).exceptions(UNCHECKED, ["base_link", "cup"]) == {}


def test_a_name_that_is_forgotten_is_in_no_pair():
    left = matrix(["a", "b", "c"], *[[True] * 3] * 3, a=True).without("a")
    assert (left.names, left.allowed, left.defaults) == (("b", "c"), {frozenset("bc")}, {})
    assert left.without("x") is left


def test_a_matrix_that_contradicts_itself_or_has_defaults_without_values_is_refused():
    for names, rows, words in (
        (["a", "b"], [[False, True]], "must be 2 rows of 2"),
        (["a", "b"], [[False, True], [True]], "must be 2 rows of 2"),
        (["a", "a"], [[False] * 2] * 2, "a name twice"),
        (["a", ""], [[False] * 2] * 2, "an empty one"),
        ([str(i) for i in range(MAX_NAMES + 1)], [], f"more than {MAX_NAMES}"),
    ):
        with pytest.raises(RefusedError, match=words):
            matrix(names, *rows)
    with pytest.raises(RefusedError, match="1 default_entry_names, 0 default_entry_values"):
        read_allowed_collision_matrix(message("AllowedCollisionMatrix", default_entry_names=["a"]))
