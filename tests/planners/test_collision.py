import numpy as np
import pytest

from planners.collision import DEPTH_ACCURACY_M, CollidingPair, CollisionModel

FOLDED_TOO_FAR = {"shoulder_lift": -1.745, "elbow_flex": 1.69, "wrist_flex": 1.0}
JAW_POSITIONS_RAD = (-0.17, 0.0, 1.7)


def state(collision, **positions_rad):
    return np.array([positions_rad.get(name, 0.0) for name in collision.joint_names])


@pytest.fixture
def random_states(collision):
    return np.random.default_rng(4).uniform(collision.lower_rad, collision.upper_rad, (300, 6))


@pytest.mark.parametrize("jaw_rad", JAW_POSITIONS_RAD)
@pytest.mark.parametrize("name", ["home", "ready", "rest", "extended"])
def test_named_states_touch_nothing(robot, collision, name, jaw_rad):
    q = state(collision, **robot.named_states["arm"][name], gripper=jaw_rad)
    assert not collision.in_collision(q)


def test_limits_and_names_are_those_of_the_robot(robot, collision):
    assert set(collision.joint_names) == {joint.name for joint in robot.movable_joints}
    for name, lower, upper in zip(collision.joint_names, collision.lower_rad, collision.upper_rad, strict=True):
        assert (lower, upper) == (robot.joints[name].lower, robot.joints[name].upper)


def test_colliding_pairs_name_the_links_deepest_first(collision):
    pairs = collision.colliding_pairs(state(collision, **FOLDED_TOO_FAR))
    assert {"shoulder_link", "lower_arm_link"} in [pair.links for pair in pairs]
    depths_m = [pair.depth_m for pair in pairs]
    assert depths_m == sorted(depths_m, reverse=True)
    assert 0.0 < depths_m[0] < 0.03


def test_no_verdict_depends_on_what_was_asked_before(robot, collision):
    # The search for a common point starts from hints that earlier questions left behind. With coal's default accuracy
    # these states get different verdicts.
    rng = np.random.default_rng(3)
    other = CollisionModel(robot)
    for q, asked_before in rng.uniform(collision.lower_rad, collision.upper_rad, (20_000, 2, 6)):
        other.colliding_pairs(asked_before)
        assert bool(collision.colliding_pairs(q)) == bool(other.colliding_pairs(q))


def test_both_ways_to_ask_for_collisions_agree(collision, random_states):
    for q in random_states:
        assert collision.in_collision(q) == bool(collision.colliding_pairs(q))


def test_an_allowed_contact_is_none_until_it_gets_deeper(collision):
    q = state(collision, **FOLDED_TOO_FAR)
    allowed = {pair.links: pair.depth_m for pair in collision.colliding_pairs(q)}
    assert not collision.in_collision(q, allowed)
    shallower = {links: depth_m - 2.0 * DEPTH_ACCURACY_M for links, depth_m in allowed.items()}
    assert collision.in_collision(q, shallower)


def test_a_contact_that_is_not_allowed_counts_beside_allowed_ones(collision):
    q = state(collision, **FOLDED_TOO_FAR)
    first, *others = collision.colliding_pairs(q)
    assert others
    assert collision.in_collision(q, {first.links: 1.0})


def test_links_of_a_pair_have_no_order():
    assert CollidingPair("a", "b", 0.0).links == CollidingPair("b", "a", 0.0).links


def test_tip_of_the_stretched_arm_is_where_it_was_measured(collision):
    # Figures of the official description at all joints zero.
    tip_m = collision.tip_position(np.zeros(6), "gripper_frame_link")
    np.testing.assert_allclose(tip_m, (0.391, 0.0, 0.226), atol=1e-3)


def test_links_that_do_not_move_stay(collision, random_states):
    np.testing.assert_array_equal(collision.tip_positions(random_states[:5], "base_link"), np.zeros((5, 3)))
