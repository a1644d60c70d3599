import pytest

from tests.helpers.servo_families import FAMILIES, Family


@pytest.fixture(params=FAMILIES.values(), ids=FAMILIES)
def family(request: pytest.FixtureRequest) -> Family:
    return request.param
