import pytest

from tests.planners.following import Follower


@pytest.fixture(scope="module")
def follower(robot, collision):
    return Follower(robot, collision)
