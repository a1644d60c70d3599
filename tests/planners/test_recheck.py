import numpy as np
import pytest

from planners.cartesian.path_timing import time_along
from planners.cartesian.spline import SplinePath
from planners.problem import MoveItErrorCode, RecheckQuestion
from planners.rates import RateLimits
from planners.recheck import recheck
from planners.scene import EMPTY_SCENE, Box, Pose, Scene, SceneObject

OTHERS = {"gripper": 0.0}
POINTS = np.array([[-1.2, 0.0, 0.0, 0.0, 0.0], [1.2, 0.2, -0.2, 0.3, 0.5]])


@pytest.fixture(scope="module")
def motion(arm):
    """A swing around the pan axis with the arm stretched out."""
    return time_along(
        SplinePath(np.array([0.0, 1.0]), POINTS), arm.joints, RateLimits(np.full(5, 2.0), np.full(5, 6.0))
    )


@pytest.fixture
def scene(collision):
    versions = iter(range(7000, 7999))

    def put(position_m, size_m=(0.05, 0.05, 0.8)):
        post = SceneObject("post", ((Box(size_m), Pose()),), Pose(position_m))
        assert collision.set_scene(Scene(next(versions), (post,))) is None

    yield put
    collision.set_scene(EMPTY_SCENE)


def ask(robot, collision, motion, from_s=0.0, others=OTHERS, group="arm"):
    return recheck(RecheckQuestion(group, motion, others, from_s), robot, collision)


def test_a_motion_is_free_in_an_empty_scene(robot, collision, motion):
    answer = ask(robot, collision, motion)
    assert answer.contact is None
    assert answer.contact_s is None


def test_an_obstacle_on_the_way_is_named_with_its_time(robot, collision, motion, scene):
    scene((0.25, 0.0, 0.2))
    answer = ask(robot, collision, motion)
    assert answer.contact.code == MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
    assert "post" in answer.contact.message
    assert collision.in_collision(np.array([*motion.sample(answer.contact_s)[0], 0.0]))


@pytest.mark.parametrize("from_share", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("angle_rad", [-1.0, -0.4, 0.1, 0.7])
def test_the_first_contact_of_the_rest_is_found(robot, collision, motion, scene, from_share, angle_rad):
    scene((float(0.3 * np.cos(angle_rad)), float(0.3 * np.sin(angle_rad)), 0.2))
    from_s = from_share * motion.duration_s
    answer = ask(robot, collision, motion, from_s)
    times_s = np.linspace(from_s, motion.duration_s, 200)
    touching = [t for t in times_s if collision.in_collision(np.array([*motion.sample(t)[0], 0.0]))]
    if touching:
        assert touching[0] - 0.03 <= answer.contact_s <= touching[0] + 0.03
    else:
        assert answer.contact is None


def test_what_is_behind_does_not_count(robot, collision, motion, scene):
    scene((0.25 * np.cos(-0.6), 0.25 * np.sin(0.6), 0.2))
    before = ask(robot, collision, motion)
    assert before.contact is not None
    later_s = before.contact_s + 0.8 * (motion.duration_s - before.contact_s)
    assert ask(robot, collision, motion, later_s).contact is None


def test_an_obstacle_where_the_arm_is_touches_now(robot, collision, motion, scene):
    from_s = 0.5 * motion.duration_s
    scene((0.25, 0.0, 0.2), (0.2, 0.2, 0.8))
    assert ask(robot, collision, motion, from_s).contact_s == from_s


def test_the_last_moment_of_a_motion_can_be_asked_about(robot, collision, motion):
    assert ask(robot, collision, motion, motion.duration_s).contact is None


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ({"group": "leg"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"group": "gripper"}, MoveItErrorCode.INVALID_MOTION_PLAN),
        ({"from_s": -0.1}, MoveItErrorCode.INVALID_MOTION_PLAN),
        ({"from_s": float("nan")}, MoveItErrorCode.INVALID_MOTION_PLAN),
        ({"others": {}}, MoveItErrorCode.START_STATE_INVALID),
    ],
)
def test_questions_about_no_motion_are_refused(robot, collision, motion, asked, code):
    assert ask(robot, collision, motion, **asked).code == code
