from __future__ import annotations

import pytest

from tests.helpers.moveit import ServiceRig


@pytest.fixture
def rig() -> ServiceRig:
    return ServiceRig()
