"""The SO-101, one with a mesh more, and an arm with seven joints."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

from robot.calibration import Calibration
from robot.description import robot_folder
from robot.description.model import RobotModel

SO101 = robot_folder.built_in("so101")
SO101_SERVOS = SO101.hardware.servos


def so101() -> RobotModel:
    """The SO-101's description."""
    return SO101.model


def nominal_calibration() -> Calibration:
    """The calibration of a flawless SO-101."""
    return replace(Calibration.nominal(SO101_SERVOS), measured=True)


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

SEVEN_JOINT_SRDF = """
<robot name="seven">
  <group name="arm"><chain base_link="pedestal" tip_link="tool"/></group>
  <group_state name="bent" group="arm">
    <joint name="a1" value="0"/><joint name="a2" value="0.5"/><joint name="a3" value="0"/>
    <joint name="a4" value="1.2"/><joint name="a5" value="0"/><joint name="a6" value="0.8"/><joint name="a7" value="0"/>
  </group_state>
  <disable_collisions link1="pedestal" link2="upper"/>
  <disable_collisions link1="upper" link2="fore"/>
  <disable_collisions link1="fore" link2="wrist"/>
  <disable_collisions link1="fore" link2="hand"/>
</robot>
"""


# Shown beside the arm: one triangle, 5 cm long.
TRIANGLE = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0))


def meshed_arm(folder: Path, mesh: str) -> dict[str, str]:
    """Write description files that name a mesh in the same folder.

    Returns:
        The settings of a server that has this arm.
    """
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
