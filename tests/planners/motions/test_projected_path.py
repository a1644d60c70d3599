import itertools

import numpy as np
import pytest

from planners.geometry.joint_space import JointSpace
from planners.goals import Constraints, OrientationConstraint
from planners.ik.constraints import ConditionSet, conditions
from planners.motions.effort import CountedSpace
from planners.motions.path import Query
from planners.motions.projected_path import projected_search
from tests.planners.invariants import never

TIP = "gripper_frame_link"
# The gripper points down within 6 degrees.
DOWN = Constraints(orientations=(OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2)),))
LEFT, RIGHT = np.array([0.8, 0.0, 0.0, 1.57, 0.0, 0.0]), np.array([-0.8, 0.3, 0.0, 1.27, 0.0, 0.0])


@pytest.fixture
def holds(goal_states, joints):
    return ConditionSet(goal_states.forward, conditions(DOWN, joints)).holds


@pytest.fixture
def setting(goal_states, collision, arm, holds):
    start, goal = (goal_states.projection(arm, DOWN, q)(q[:5]) for q in (LEFT, RIGHT))
    space = JointSpace(collision, arm, np.zeros(6), holds=holds)
    project = goal_states.projection(arm, DOWN, np.zeros(6))
    return Query(CountedSpace(space), start, [goal], 0.02), project


def test_path_leads_from_start_to_goal_where_the_condition_holds(setting, holds):
    query, project = setting
    path = projected_search(query, project, 1, never)
    np.testing.assert_array_equal(path[0], query.start)
    np.testing.assert_array_equal(path[-1], query.goals[0])
    for start, end in itertools.pairwise(path):
        assert all(holds(np.append(start + u * (end - start), 0.0)) for u in (0.0, 0.5, 1.0))


def test_same_query_and_seed_have_the_same_path(setting):
    query, project = setting
    np.testing.assert_array_equal(
        projected_search(query, project, 3, never), projected_search(query, project, 3, never)
    )


def test_search_that_is_stopped_has_no_path(setting):
    query, project = setting
    assert projected_search(query, project, 1, lambda: True) is None


def test_search_without_any_way_ends_when_stopped(setting):
    query, _ = setting
    asked = iter(range(50))
    assert projected_search(query, lambda _: None, 1, lambda: next(asked, None) is None) is None
