from __future__ import annotations

import pytest
from pydantic import ValidationError

from server.moveit.parameters import ServoParameters


def test_without_collision_checks_no_distance_is_kept() -> None:
    assert ServoParameters().limits.scene_distance_m == ServoParameters().scene_distance
    free = ServoParameters(check_collisions=False).limits
    assert free.scene_distance_m is None
    assert free.self_distance_m is None


def test_motion_must_be_slowed_before_it_is_stopped() -> None:
    with pytest.raises(ValidationError, match="lower_singularity_threshold"):
        ServoParameters(lower_singularity_threshold=30.0, hard_stop_singularity_threshold=20.0)
