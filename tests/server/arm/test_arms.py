"""Several arms by their settings: files with prefixed names, and the beat in which their states are told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robot.calibration import save
from robot.hardware.config import IdealConfig
from server.arm.arms import JoinedBeat, joined_robot, read_arms, without_prefix
from server.arm.setup import Description
from server.config import ArmSettings, Settings
from server.errors import ConfigurationError
from tests.helpers.robots import nominal_calibration, so101


def settings(**arms: dict[str, Any]) -> Settings:
    return Settings.model_validate({"arms": arms})


def test_below_a_name_an_arm_has_the_same_calibration_and_limits_and_without_it_the_plain_names(tmp_path: Path) -> None:
    save(nominal_calibration(), tmp_path / "left.json")
    arm = read_arms(settings(left={"calibration": str(tmp_path / "left.json")}))["left"]
    plain = Description.read(ArmSettings(calibration=tmp_path / "left.json"))
    for prefix, calibration in (("left_", arm.description.calibration), ("", plain.calibration)):
        assert calibration is not None
        assert without_prefix(calibration, prefix) == nominal_calibration()
    for joint in plain.robot.movable_joints:
        limits = arm.config.robot.joints[f"left_{joint.name}"]
        assert (limits.lower, limits.upper) == (joint.lower, joint.upper)


def test_arms_of_different_kinds_stand_in_one_description(tmp_path: Path) -> None:
    urdf, srdf = tmp_path / "one.urdf", tmp_path / "one.srdf"
    urdf.write_text(so101().urdf)
    srdf.write_text(so101().srdf)
    arms = read_arms(
        settings(
            left={"base_xyz_m": (0.0, 0.3, 0.0), "role": "leader"},
            koch={"robot": "koch_v1_1", "base_rpy_rad": (0.0, 0.0, 1.5)},
            ideal={"urdf": str(urdf), "srdf": str(srdf)},
        )
    )
    assert isinstance(arms["ideal"].config.hardware, IdealConfig)
    assert [arm.config.start_enabled for arm in arms.values()] == [False, True, True], "a leader starts without torque"
    whole = joined_robot(arms)
    assert [joint.name for joint in whole.movable_joints] == [name for arm in arms.values() for name in arm.joint_names]


@pytest.mark.parametrize(
    ("arm", "words"),
    [
        ({"role": "leader", "serial": "/dev/nothing"}, "a leader needs a calibration"),
        ({"robot": "nobody"}, "'nobody' is no folder"),
        ({"zero_offset_rad": {"knee": 0.1}}, "knee"),
        ({"emulator": {"write_log": "/nowhere/log"}}, "emulator.write_log"),
    ],
)
def test_what_cannot_be_used_is_refused_with_the_name_of_the_arm(arm: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"^arms.left: .*{words}"):
        read_arms(settings(left=arm))


def test_states_of_arms_are_told_once_a_period_and_silent_arms_and_bursts_hold_nobody_up() -> None:
    arms, period_s, random = ("a", "b", "c"), 0.02, np.random.default_rng(3)

    def told(arrivals: list[tuple[str, float]]) -> int:
        beat = JoinedBeat(frozenset(arms), period_s)
        return sum(beat.takes(name, at_s) for name, at_s in arrivals)

    in_any_order = [
        (name, tick * period_s + number * 0.002)
        for tick in range(100)
        for number, name in enumerate(random.permutation(arms).tolist())
    ]
    assert told(in_any_order) == pytest.approx(100, abs=2)
    assert told([(name, tick * period_s) for tick in range(100) for name in ("a", "b")]) >= 98
    assert told([(name, burst * 0.1) for burst in range(20) for name in arms for _ in range(5)]) <= 2 * 20
