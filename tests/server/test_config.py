from __future__ import annotations

import pytest
from pydantic import ValidationError

from server.config import ServerSettings, Settings


def test_the_defaults_are_those_of_the_old_goal_node() -> None:
    moveit = Settings().moveit
    assert (moveit.group_name, moveit.num_planning_attempts, moveit.allowed_planning_time) == ("arm", 5, 5.0)
    assert (moveit.max_velocity_scaling, moveit.max_acceleration_scaling) == (0.3, 0.3)
    assert (moveit.position_tolerance, moveit.joint_tolerance) == (0.01, 0.01)


@pytest.mark.parametrize(("given", "missing"), [("tls_key", "tls_certificate"), ("tls_certificate", "tls_key")])
def test_a_certificate_needs_its_key_and_the_other_way_round(given: str, missing: str) -> None:
    with pytest.raises(ValidationError, match=f"must be given together; {missing} is missing"):
        ServerSettings.model_validate({given: "x.pem"})
