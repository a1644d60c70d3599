"""The SO-101, one with a mesh more, and an arm with seven joints."""

import re
import struct
from collections.abc import Iterable
from dataclasses import replace
from itertools import cycle
from pathlib import Path

from robot.calibration import Calibration
from robot.description import robot_folder
from robot.description.model import RobotModel
from robot.emulator.populations import Population

SO101 = robot_folder.built_in("so101")
SO101_SERVOS = SO101.hardware.servos


def so101() -> RobotModel:
    """The SO-101's description."""
    return SO101.model


def nominal_calibration() -> Calibration:
    """The calibration of a flawless SO-101."""
    return replace(Calibration.nominal(SO101_SERVOS), measured=True)


def recalibrated(calibration: Calibration, population: Population) -> Calibration:
    """The calibration that is right for servos with shifted offsets: the joints and their stops are where they were."""
    shifts = population.offset_shift_ticks
    joints = (
        replace(
            joint,
            homing_offset=joint.homing_offset + shift,
            range_min=joint.range_min if joint.servo.turns_freely else joint.range_min - shift,
            range_max=joint.range_max if joint.servo.turns_freely else joint.range_max - shift,
        )
        for joint, shift in zip(calibration.joints, cycle(shifts))
    )
    return replace(calibration, joints=tuple(joints), offsets_known=True)


SEVEN_JOINT_URDF = """
<robot name="seven">
  <link name="pedestal"><collision>
    <origin xyz="0 0 0.05"/><geometry><cylinder radius="0.06" length="0.1"/></geometry></collision></link>
  <link name="turret"/>
  <link name="upper"><collision>
    <origin xyz="0 0 0.125"/><geometry><cylinder radius="0.03" length="0.2"/></geometry></collision></link>
  <link name="upper_roll"/>
  <link name="fore"><collision>
    <origin xyz="0 0 0.115"/><geometry><cylinder radius="0.025" length="0.18"/></geometry></collision></link>
  <link name="fore_roll"/>
  <link name="wrist"><collision><geometry><sphere radius="0.03"/></geometry></collision></link>
  <link name="hand"><collision>
    <origin xyz="0 0 0.06"/><geometry><box size="0.06 0.03 0.08"/></geometry></collision></link>
  <link name="tool"/>
  <joint name="a1" type="revolute"><parent link="pedestal"/><child link="turret"/>
    <origin xyz="0 0 0.15"/><axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9" velocity="2" effort="9"/></joint>
  <joint name="a2" type="revolute"><parent link="turret"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-1.9" upper="1.9" velocity="2" effort="9"/></joint>
  <joint name="a3" type="revolute"><parent link="upper"/><child link="upper_roll"/>
    <origin xyz="0 0 0.25"/><axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9" velocity="2" effort="9"/></joint>
  <joint name="a4" type="revolute"><parent link="upper_roll"/><child link="fore"/>
    <axis xyz="0 1 0"/><limit lower="-2.3" upper="2.3" velocity="2.5" effort="9"/></joint>
  <joint name="a5" type="revolute"><parent link="fore"/><child link="fore_roll"/>
    <origin xyz="0 0 0.23"/><axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9" velocity="3" effort="9"/></joint>
  <joint name="a6" type="revolute"><parent link="fore_roll"/><child link="wrist"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="9"/></joint>
  <joint name="a7" type="revolute"><parent link="wrist"/><child link="hand"/>
    <axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9" velocity="4" effort="9"/></joint>
  <joint name="mount" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0 0 0.12"/></joint>
</robot>
"""


def _state(name: str, group: str, positions: dict[str, float]) -> str:
    joints = "".join(f'<joint name="{joint}" value="{value}"/>' for joint, value in positions.items())
    return f'<group_state name="{name}" group="{group}">{joints}</group_state>'


_BENT = {"a1": 0.0, "a2": 0.5, "a3": 0.0, "a4": 1.2, "a5": 0.0, "a6": 0.8, "a7": 0.0}

SEVEN_JOINT_SRDF = f"""
<robot name="seven">
  <group name="arm"><chain base_link="pedestal" tip_link="tool"/></group>
  {_state("bent", "arm", _BENT)}
  <disable_collisions link1="pedestal" link2="upper"/>
  <disable_collisions link1="upper" link2="fore"/>
  <disable_collisions link1="fore" link2="wrist"/>
  <disable_collisions link1="fore" link2="hand"/>
</robot>
"""


# Shown beside the arm: one triangle, 5 cm long.
TRIANGLE = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0))


def meshed_arm(folder: Path, mesh: str) -> dict[str, str]:
    """Write description files that name a mesh in the same folder; return the settings of a server with this arm."""
    visual = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    joint = '<joint name="held" type="fixed"><parent link="base_link"/><child link="meshed"/></joint>'
    arm = so101()
    urdf, srdf = folder / "arm.urdf", folder / "arm.srdf"
    urdf.write_text(arm.urdf.replace("</robot>", f'<link name="meshed">{visual}</link>{joint}</robot>'))
    srdf.write_text(arm.srdf)
    return {"ARMBRIDGE_ARM__URDF": str(urdf), "ARMBRIDGE_ARM__SRDF": str(srdf)}


def small_stl() -> bytes:
    """A mesh of one triangle, in STL's binary form."""
    numbers = [number for corner in TRIANGLE for number in corner]
    return bytes(80) + struct.pack("<I12fH", 1, *numbers, 0)


def _named(text: str, prefix: str) -> str:
    """The links and joints of the seven-joint arm, without the robot around them, their names with a prefix."""
    inner = text.strip().removeprefix('<robot name="seven">').removesuffix("</robot>")
    return re.sub(r'\b(name|link)="', rf'\1="{prefix}', inner)


def _chain(names: Iterable[str]) -> str:
    """Pairs of links that are next to each other, or next but one: they touch always or never."""
    links = list(names)
    pairs = [(a, b) for i, a in enumerate(links) for b in links[i + 1 : i + 3]]
    return "".join(f'<disable_collisions link1="{a}" link2="{b}"/>' for a, b in pairs)


_LIFTED_LINKS = ("mast", "pedestal", "turret", "upper", "upper_roll", "fore", "fore_roll", "wrist", "hand")

# A mobile manipulator in small: the seven-joint arm on a column that rises, with two fingers that slide.
LIFTED_URDF = f"""
<robot name="lifted">
  <link name="base"/>
  <link name="mast"><collision>
    <origin xyz="0 0 -0.1"/><geometry><box size="0.1 0.1 0.2"/></geometry></collision></link>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="mast"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="0" upper="0.3" velocity="0.2" effort="9"/></joint>
  <joint name="shoulders" type="fixed"><parent link="mast"/><child link="pedestal"/></joint>
  {_named(SEVEN_JOINT_URDF, "")}
  <link name="left_finger"><collision><geometry><box size="0.01 0.01 0.04"/></geometry></collision></link>
  <link name="right_finger"><collision><geometry><box size="0.01 0.01 0.04"/></geometry></collision></link>
  <joint name="left_finger_joint" type="prismatic"><parent link="hand"/><child link="left_finger"/>
    <origin xyz="0 0.007 0.12"/><axis xyz="0 1 0"/><limit lower="0" upper="0.05" velocity="0.1" effort="9"/></joint>
  <joint name="right_finger_joint" type="prismatic"><parent link="hand"/><child link="right_finger"/>
    <origin xyz="0 -0.007 0.12"/><axis xyz="0 -1 0"/><limit lower="0" upper="0.05" velocity="0.1" effort="9"/></joint>
</robot>
"""

LIFTED_SRDF = f"""
<robot name="lifted">
  <group name="arm"><chain base_link="pedestal" tip_link="tool"/></group>
  <group name="arm_with_torso"><chain base_link="base" tip_link="tool"/></group>
  <group name="gripper"><joint name="left_finger_joint"/><joint name="right_finger_joint"/></group>
  {_state("bent", "arm", _BENT)}
  {_state("raised", "arm_with_torso", {"lift": 0.2, **_BENT})}
  {_state("open", "gripper", {"left_finger_joint": 0.05, "right_finger_joint": 0.05})}
  {_chain(_LIFTED_LINKS)}
  {_chain(("left_finger", "right_finger", "hand"))}
  <disable_collisions link1="wrist" link2="left_finger"/><disable_collisions link1="wrist" link2="right_finger"/>
</robot>
"""

# Two of the seven-joint arms, 0.9 m apart: they reach each other in the middle.
PAIR_URDF = f"""
<robot name="pair">
  <link name="table"/>
  {_named(SEVEN_JOINT_URDF, "left_")}
  {_named(SEVEN_JOINT_URDF, "right_")}
  <joint name="left_mount_base" type="fixed"><parent link="table"/><child link="left_pedestal"/>
    <origin xyz="0 0.45 0"/></joint>
  <joint name="right_mount_base" type="fixed"><parent link="table"/><child link="right_pedestal"/>
    <origin xyz="0 -0.45 0"/></joint>
</robot>
"""


_SIDES = ("left", "right")
_SEVEN_LINKS = ("pedestal", "turret", "upper", "upper_roll", "fore", "fore_roll", "wrist", "hand")

PAIR_SRDF = f"""
<robot name="pair">
  <group name="left_arm"><chain base_link="left_pedestal" tip_link="left_tool"/></group>
  <group name="right_arm"><chain base_link="right_pedestal" tip_link="right_tool"/></group>
  <group name="both_arms">
    {"".join(f'<joint name="{side}_a{number}"/>' for side in _SIDES for number in range(1, 8))}
  </group>
  {"".join(_state("bent", f"{side}_arm", {f"{side}_{a}": at for a, at in _BENT.items()}) for side in _SIDES)}
  {"".join(_chain(f"{side}_{link}" for link in _SEVEN_LINKS) for side in _SIDES)}
</robot>
"""


def folder_arguments(folder: Path, urdf: str, srdf: str) -> str:
    """Write an arm's folder; returns the arguments of a server with it."""
    (folder / "arm.urdf").write_text(urdf)
    (folder / "arm.srdf").write_text(srdf)
    (folder / "robot.toml").write_text('[robot]\ntitle = "test arm"\nurdf = "arm.urdf"\nsrdf = "arm.srdf"\n')
    return f"--robot {folder}"
