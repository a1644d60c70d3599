import numpy as np
import pytest

from planners.assistant.link_shapes import link_shapes, shapes_in_link
from planners.assistant.pairs import SelfContacts, UncheckedPair, free_state, unchecked_pairs
from robot.description import model

# A post; a bar that turns beside it at half its reach; a flag fixed above the post that overlaps it; a far box.
URDF = """
<robot name="r">
  <link name="post"><collision><geometry><box size="0.1 0.1 0.2"/></geometry></collision></link>
  <link name="slider"/>
  <link name="flag"><collision><geometry><box size="0.2 0.02 0.02"/></geometry></collision></link>
  <link name="bar"><collision><geometry><box size="0.3 0.02 0.02"/></geometry></collision></link>
  <link name="far">
    <collision><origin xyz="0.5 0 0"/><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
  <joint name="up" type="prismatic"><parent link="post"/><child link="slider"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.01" velocity="1" effort="1"/></joint>
  <joint name="side" type="fixed"><parent link="slider"/><child link="flag"/></joint>
  <joint name="swing" type="revolute"><parent link="flag"/><child link="bar"/><origin xyz="0 0.1 0"/><axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="1.5" velocity="1" effort="1"/></joint>
  <joint name="out" type="revolute"><parent link="bar"/><child link="far"/><axis xyz="0 0 1"/>
    <limit lower="-0.1" upper="0.1" velocity="1" effort="1"/></joint>
</robot>
"""


def contacts_of(urdf):
    robot = model.parse(urdf, '<robot name="r"><group name="g"><joint name="up"/><joint name="swing"/></group></robot>')
    return SelfContacts(robot, {link: shapes_in_link(link, shapes) for link, shapes in link_shapes(robot).items()})


@pytest.fixture(scope="module")
def contacts():
    return contacts_of(URDF)


@pytest.fixture(scope="module")
def found(contacts):
    return unchecked_pairs(contacts, 400, 0, lambda _done: None)


def test_links_are_adjacent_touch_never_or_always_and_those_that_touch_in_some_states_are_checked(found):
    # Links without a shape are skipped: those before and behind them are adjacent.
    adjacent = {(pair.first, pair.second) for pair in found if pair.reason == "Adjacent"}
    assert adjacent == {("flag", "post"), ("bar", "flag"), ("bar", "far")}
    assert UncheckedPair("post", "far", "Never") in found
    assert frozenset(("post", "bar")) not in {frozenset((pair.first, pair.second)) for pair in found}
    inside = contacts_of(URDF.replace('<origin xyz="0 0.1 0"/>', '<origin xyz="0 0 0"/>'))
    assert UncheckedPair("post", "bar", "Always") in unchecked_pairs(inside, 50, 0, lambda _done: None)


def test_a_free_state_is_drawn_where_none_is_given(contacts, found):
    state, is_free = free_state(contacts, found, (np.array([0.0, 1.5, 0.0]),), 200, 0)
    assert is_free
    assert not contacts.touching(state, [("post", "bar")])
