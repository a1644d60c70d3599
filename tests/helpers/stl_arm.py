"""A made-up arm whose links are STL meshes: four joints, brackets with hollows, and a gripper of two fingers."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

URDF = """
<robot name="Mesh Arm">
  <link name="base"><collision><geometry><mesh filename="package://mesh_arm/meshes/base.stl"/></geometry></collision>
    <visual><geometry><mesh filename="package://mesh_arm/meshes/base.stl"/></geometry></visual></link>
  <link name="turret">
    <collision><geometry><mesh filename="package://mesh_arm/meshes/turret.stl"/></geometry></collision></link>
  <link name="upper">
    <collision><geometry><mesh filename="package://mesh_arm/meshes/channel.stl"/></geometry></collision></link>
  <link name="fore">
    <collision><geometry><mesh filename="package://mesh_arm/meshes/channel.stl"/></geometry></collision></link>
  <link name="palm">
    <collision><origin xyz="0 0 0.02"/><geometry><box size="0.03 0.08 0.02"/></geometry></collision></link>
  <link name="tool_point"/>
  <link name="left">
    <collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.008 0.06"/></geometry></collision></link>
  <link name="right">
    <collision><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.008 0.06"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="turret"/><origin xyz="0 0 0.06"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="9"/></joint>
  <joint name="lift" type="revolute"><parent link="turret"/><child link="upper"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 1 0"/><limit lower="-1.6" upper="1.6" velocity="2" effort="9"/></joint>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.22"/>
    <axis xyz="0 1 0"/><limit lower="-2.8" upper="2.8" velocity="2" effort="9"/></joint>
  <joint name="roll" type="revolute"><parent link="fore"/><child link="palm"/><origin xyz="0 0 0.22"/>
    <axis xyz="0 0 1"/><limit lower="0.5" upper="3" velocity="2" effort="9"/></joint>
  <joint name="tool" type="fixed"><parent link="palm"/><child link="tool_point"/><origin xyz="0 0 0.09"/></joint>
  <joint name="left_finger" type="prismatic"><parent link="palm"/><child link="left"/><origin xyz="0 0.006 0.03"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.03" velocity="0.1" effort="9"/></joint>
  <joint name="right_finger" type="prismatic"><parent link="palm"/><child link="right"/><origin xyz="0 -0.006 0.03"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="0.03" velocity="0.1" effort="9"/></joint>
</robot>
"""

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def write_package(folder: Path) -> Path:
    """Write the package mesh_arm into a folder; return the path of its URDF."""
    package = folder / "mesh_arm"
    (package / "meshes").mkdir(parents=True)
    (package / "urdf").mkdir()
    write_stl(package / "meshes" / "base.stl", boxes_union([((-0.05, -0.05, 0.0), (0.05, 0.05, 0.05))]))
    write_stl(package / "meshes" / "turret.stl", boxes_union([((-0.03, -0.03, 0.0), (0.03, 0.03, 0.03))]))
    write_stl(package / "meshes" / "channel.stl", channel())
    urdf = package / "urdf" / "arm.urdf"
    urdf.write_text(URDF)
    return urdf


def channel() -> np.ndarray:
    """Triangles of a U-shaped beam of 20 cm, open towards x, shape (m, 3, 3) [m]."""
    # Corners of the profile in x and y, counterclockwise seen from above.
    profile = [(-0.02, -0.02), (0.02, -0.02), (0.02, -0.016), (-0.016, -0.016)]
    profile += [(-0.016, 0.016), (0.02, 0.016), (0.02, 0.02), (-0.02, 0.02)]
    bottom, top = 0.015, 0.2
    sides = []
    for (ax, ay), (bx, by) in zip(profile, [*profile[1:], profile[0]], strict=True):
        a, b, c, d = (ax, ay, bottom), (bx, by, bottom), (bx, by, top), (ax, ay, top)
        sides += [(a, b, c), (a, c, d)]
    # The profile as three rectangles, by indices of its corners.
    lids = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 7), (4, 5, 6), (4, 6, 7)]
    for i, j, k in lids:
        up = [(*profile[index], top) for index in (i, j, k)]
        down = [(*profile[index], bottom) for index in (k, j, i)]
        sides += [tuple(up), tuple(down)]
    return np.array(sides)


def boxes_union(boxes: Iterable[Box]) -> np.ndarray:
    """Triangles of boxes, shape (m, 3, 3) [m]."""
    triangles = []
    for lower, upper in boxes:
        corners = np.array([[(lower, upper)[i >> k & 1][k] for k in range(3)] for i in range(8)])
        quads = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
        for a, b, c, d in quads:
            triangles += [corners[[a, b, c]], corners[[a, c, d]]]
    return np.array(triangles)


def write_stl(path: Path, triangles: np.ndarray) -> None:
    """Write triangles as binary STL."""
    records = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("bytes", "<u2")])
    records["corners"] = triangles
    path.write_bytes(b"\0" * 80 + np.uint32(len(triangles)).tobytes() + records.tobytes())
