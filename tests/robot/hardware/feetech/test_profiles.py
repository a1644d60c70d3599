from __future__ import annotations

import pytest

from robot.description.servo_table import ProfileSpec
from robot.errors import DescriptionError
from robot.hardware.feetech.profiles import FACTORY, LEROBOT, ServoProfile, nearest_profile, profile_of
from robot.hardware.feetech.registers import SETTINGS, Register


def held(values: dict[Register, int]) -> dict[Register, int]:
    return {**dict.fromkeys(SETTINGS, 0), **values}


@pytest.mark.parametrize("profile", [FACTORY, LEROBOT])
@pytest.mark.parametrize("gripper", [False, True])
def test_servos_of_a_profile_do_not_differ_from_it(profile: ServoProfile, gripper: bool) -> None:
    assert profile.differences(held(profile.expected(gripper=gripper)), gripper=gripper) == {}


@pytest.mark.parametrize("profile", [FACTORY, LEROBOT])
def test_the_nearest_profile_is_found_though_a_setting_differs(profile: ServoProfile) -> None:
    servos = [(held(profile.expected(gripper=gripper)), gripper) for gripper in (False, False, True)]
    servos[0] = (held({**profile.expected(gripper=False), Register.D_GAIN: 40}), False)
    assert nearest_profile(servos) is profile


def test_a_profile_by_name_is_the_known_one() -> None:
    assert profile_of(ProfileSpec("lerobot")) is LEROBOT


def test_registers_of_an_arm_replace_those_of_the_base_at_every_servo() -> None:
    profile = profile_of(ProfileSpec("lerobot", {"P_GAIN": 20, "overload_torque": 60}, {"MAX_TORQUE": 400}))
    arm, gripper = profile.expected(gripper=False), profile.expected(gripper=True)
    assert arm[Register.P_GAIN] == gripper[Register.P_GAIN] == 20
    assert arm[Register.OVERLOAD_TORQUE] == gripper[Register.OVERLOAD_TORQUE] == 60
    assert (arm[Register.MAX_TORQUE], gripper[Register.MAX_TORQUE]) == (1000, 400)
    assert gripper[Register.PROTECTION_CURRENT] == 250


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (
            ProfileSpec(registers={"P_GAINN": 20}),
            r"hardware.profile.registers.P_GAINN: there is no such setting; .*P_GAIN",
        ),
        (ProfileSpec(registers={"GOAL_POSITION": 20}), "there is no such setting"),
        (ProfileSpec(gripper={"P_GAIN": 256}), r"hardware.profile.gripper.P_GAIN: must be 0 to 255, not 256"),
        (ProfileSpec(registers={"HOMING_OFFSET": 2048}), "must be -2047 to 2047, not 2048"),
    ],
)
def test_a_register_that_cannot_be_is_refused_with_its_place(spec: ProfileSpec, words: str) -> None:
    with pytest.raises(DescriptionError, match=words):
        profile_of(spec)
