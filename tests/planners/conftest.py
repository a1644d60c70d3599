import time

import numpy as np
import pytest

from planners import pool as pool_module
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import JointSpace
from planners.ik.goal_states import GoalStates
from planners.pipeline import Planner
from planners.problem import RateLimits
from planners.scene import EMPTY_SCENE
from tests.helpers import resources
from tests.helpers.fake_workers import Farm
from tests.helpers.robots import so101
from tests.planners.following import Follower
from tests.planners.scenes import scene
from tests.planners.setting import Setting


@pytest.fixture(scope="session")
def robot():
    return so101()


@pytest.fixture(scope="session")
def arm(robot):
    return robot.groups["arm"]


@pytest.fixture
def at_home(robot):
    return {joint.name: 0.0 for joint in robot.movable_joints}


@pytest.fixture(scope="session")
def collision(robot):
    return CollisionModel(robot)


@pytest.fixture(scope="session")
def own_collision(robot):
    return CollisionModel(robot)


@pytest.fixture
def changing(own_collision):
    """One whose scene may change; it is empty again after the test."""
    yield own_collision
    own_collision.set_scene(EMPTY_SCENE)


@pytest.fixture
def space_in(changing, arm):
    def build(surroundings, **arguments):
        assert changing.set_scene(surroundings) is None
        return JointSpace(changing, arm.joints, np.zeros(6), **arguments)

    return build


@pytest.fixture(scope="session")
def goal_states(robot, collision):
    return GoalStates(robot, collision)


@pytest.fixture(scope="session")
def planner(robot):
    # By the clock of planner processes, which a busy machine does not hurry.
    return Planner(robot, time.process_time)


@pytest.fixture
def setting(planner, robot, collision):
    return Setting(planner, robot, collision)


@pytest.fixture(scope="session")
def follower(robot, collision):
    return Follower(robot, collision)


@pytest.fixture
def joint_space(collision, arm):
    return JointSpace(collision, arm.joints, np.zeros(6))


@pytest.fixture(scope="session")
def rate_limits(robot, arm):
    joints = [robot.joints[name] for name in arm.joints]
    rates = ([getattr(joint, rate) for joint in joints] for rate in ("max_velocity", "max_acceleration"))
    return RateLimits(*map(np.array, rates))


@pytest.fixture(scope="session")
def shared_data():
    return resources.shared_data()


@pytest.fixture
def farm(monkeypatch):
    """Workers in place of the processes of every pool of a test."""
    made = Farm()
    monkeypatch.setattr(pool_module, "WorkerProcess", made.make)
    monkeypatch.setattr(pool_module, "Template", lambda *_: made)
    return made


@pytest.fixture
def put():
    """Put objects around the arm of a planner or a collision model; they are gone after the test."""
    models = []

    def set_scene(model, *objects):
        assert model.set_scene(scene(*objects)) is None
        models.append(model)

    yield set_scene
    for model in models:
        model.set_scene(EMPTY_SCENE)
