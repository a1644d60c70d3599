"""Built-in arms are data: each is complete, and none is known by name to the program."""

import re
from pathlib import Path

import numpy as np
import pytest

from robot.calibration import Calibration
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.limits import within_calibration
from robot.description.robot_folder import BUILT_IN, built_in, built_in_names
from tests.helpers.source import PACKAGES

ROOT = Path(__file__).parents[3]
NAMES = built_in_names()


@pytest.mark.parametrize("name", NAMES)
def test_every_named_state_lies_within_the_limits_and_those_of_a_flawless_arm_within_its_calibration(name: str) -> None:
    found = built_in(name)
    states = [(found.model, state) for states in found.model.named_states.values() for state in states.values()]
    if found.hardware.servos:
        nominal = Calibration.nominal(found.hardware.servos)
        # Only a measured calibration says where the zero is.
        assert not nominal.zero_is_known
        # A gripper's states are its stops, where the calibrated range keeps a margin.
        arm = within_calibration(found.model, nominal)
        states += [(arm, state) for state in arm.named_states["arm"].values()]
    for arm, state in states:
        for joint, position in state.items():
            assert arm.joints[joint].lower <= position <= arm.joints[joint].upper, (joint, position)


def poses(name: str, mirrored: bool) -> list[tuple[float, ...]]:
    """Height and reach of the tip from the shoulder's axis at every named state, and where it points."""
    arm = built_in(name).model
    forward = ForwardPlacements(arm)
    rest = dict.fromkeys((joint.name for joint in arm.movable_joints), 0.0)
    found = []
    for state in ("home", "ready", "extended"):
        placed = forward.transforms(rest | dict(arm.named_states["arm"][state]))
        tip, lift = placed[arm.tip_link], placed[arm.joints["shoulder_lift"].child]
        reach, points = tip[:3, 3] - lift[:3, 3], tip[:3, 2]
        ahead = (-reach[1], -points[1]) if mirrored else (reach[0], points[0])
        found.append((ahead[0], reach[2], ahead[1], points[2]))
    return found


def test_the_so100_stands_as_the_so101_at_the_states_of_the_same_names() -> None:
    # The SO-100's URDF looks along -y, the SO-101's along x.
    assert np.allclose(poses("so100", mirrored=True), poses("so101", mirrored=False), atol=0.05)


def test_the_so100_s_servos_turn_as_the_so101_s_do() -> None:
    """The same ticks put both arms into the same pose: the servos and lerobot's degrees are the same."""
    ticks = dict(zip(("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex"), (400, -300, 250, 200), strict=True))
    tips = []
    for name in ("so101", "so100"):
        found = built_in(name)
        arm, joints = found.model, {joint.joint: joint for joint in Calibration.nominal(found.hardware.servos).joints}
        rest = dict.fromkeys((joint.name for joint in arm.movable_joints), 0.0)
        turned = {joint: joints[joint].rad_from_ticks(2047.5 + ticks.get(joint, 0)) for joint in joints}
        placed = ForwardPlacements(arm).transforms(rest | turned)
        tip = placed[arm.tip_link][:3, 3] - placed[arm.joints["shoulder_pan"].child][:3, 3]
        tips.append(np.array([tip[0], tip[1]]) if name == "so101" else np.array([-tip[1], tip[0]]))
    assert np.allclose(*tips, atol=0.03)


def test_no_module_knows_the_joints_of_a_built_in_arm() -> None:
    joints = {
        joint.name
        for name in NAMES
        for joint in built_in(name).model.movable_joints
        if "_" in joint.name and "gripper" not in joint.name
    }
    known = re.compile(r"\b(" + "|".join(sorted(joints)) + r")\b")
    found = []
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*"):
            if path.suffix not in {".py", ".ts"} or path.name.endswith(".test.ts") or "node_modules" in path.parts:
                continue
            if BUILT_IN not in path.parents:
                found += [f"{path.relative_to(ROOT)}: {line}" for line in known.findall(path.read_text())]
    assert found == []
