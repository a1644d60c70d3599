import pytest

from tests.helpers.moveit import ServiceRig


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()
