import pytest
from pydantic import ValidationError

from server.errors import ServiceError
from server.moveit.parameters import MAX_CONFIGURATIONS, MAX_KEYS, MoveItParameters, PlannerParameters, ServoParameters

CONFIGURED = MoveItParameters(group_name="arm")


@pytest.fixture
def parameters() -> PlannerParameters:
    return PlannerParameters(CONFIGURED)


def test_parameters_of_a_planner_override_others_and_an_invalid_value_changes_nothing(parameters) -> None:
    for key, value in (("planner_id", "CHOMP"), ("allowed_planning_time", "0"), ("joint_tolerance", "x")):
        with pytest.raises(ServiceError, match=key):
            parameters.set("arm", "", {key: value}, replace=False)
        assert parameters.of("arm") == CONFIGURED, key
    for group, planner, attempts in (("", "", 2), ("arm", "", 3), ("arm", "RRT", 4)):
        parameters.set(group, planner, {"num_planning_attempts": str(attempts)}, replace=False)
    assert parameters.of("gripper").num_planning_attempts == 2
    assert parameters.of("arm", "RRTstar").num_planning_attempts == 3
    assert parameters.of("arm", "RRT").num_planning_attempts == 4


def test_the_number_of_parameters_is_bounded(parameters: PlannerParameters) -> None:
    with pytest.raises(ServiceError, match=str(MAX_KEYS)):
        parameters.set("", "", {str(key): "1" for key in range(MAX_KEYS + 1)}, replace=False)
    for number in range(MAX_CONFIGURATIONS):
        parameters.set("arm", str(number), {}, replace=False)
    with pytest.raises(ServiceError, match=str(MAX_CONFIGURATIONS)):
        parameters.set("arm", "one more", {}, replace=False)


def test_without_collision_checks_no_distance_is_kept_and_motion_must_be_slowed_before_it_is_stopped() -> None:
    assert ServoParameters().limits.scene_distance_m == ServoParameters().scene_distance
    free = ServoParameters(check_collisions=False).limits
    assert (free.scene_distance_m, free.self_distance_m) == (None, None)
    with pytest.raises(ValidationError, match="lower_singularity_threshold"):
        ServoParameters(lower_singularity_threshold=30.0, hard_stop_singularity_threshold=20.0)
