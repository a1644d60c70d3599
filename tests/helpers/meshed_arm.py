"""The built-in arm with one mesh more, as files of its own."""

from __future__ import annotations

import struct
from pathlib import Path

from robot.description import model

# Shown beside the arm: one triangle, 5 cm long.
TRIANGLE = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0))


def meshed_arm(folder: Path, mesh: str) -> dict[str, str]:
    """Write description files that name a mesh in the same folder.

    Returns:
        The settings of a server that has this arm.
    """
    visual = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    joint = '<joint name="held" type="fixed"><parent link="base_link"/><child link="meshed"/></joint>'
    arm = model.builtin()
    urdf, srdf = folder / "arm.urdf", folder / "arm.srdf"
    urdf.write_text(arm.urdf.replace("</robot>", f'<link name="meshed">{visual}</link>{joint}</robot>'))
    srdf.write_text(arm.srdf)
    return {"ARMBRIDGE_ARM__URDF": str(urdf), "ARMBRIDGE_ARM__SRDF": str(srdf)}


def small_stl() -> bytes:
    """A mesh of one triangle, in STL's binary form."""
    numbers = [number for corner in TRIANGLE for number in corner]
    return bytes(80) + struct.pack("<I12fH", 1, *numbers, 0)
