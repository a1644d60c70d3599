"""MPlib for comparison: an environment of its own, the same robot with the same hulls, and a process for its plans."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robot.description.model import Hull, RobotModel
from robot.description.robot_folder import built_in

REQUIREMENTS = ("mplib==0.2.1", "numpy<2")
ENVIRONMENT = Path(__file__).parents[1] / "build" / "mplib"
PEER = Path(__file__).with_name("mplib_peer.py")

# Downloads of some 100 MB.
INSTALL_S = 600.0

# At most two seconds a problem, plus the start.
PLAN_S = 300.0

# Marks the lines of its output that are answers; MPlib prints lines of its own.
MARK = "@"


def installed() -> str:
    """Make its environment if there is none; returns the reason of a failure, or an empty text."""
    python = str(_python())
    if _python().exists() and subprocess.run([python, "-c", "import mplib"], check=False).returncode == 0:
        return ""
    try:
        subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], capture_output=True, check=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:", *REQUIREMENTS]
        subprocess.run(pip, capture_output=True, text=True, check=True, timeout=INSTALL_S)
    except subprocess.TimeoutExpired:
        return f"pip took longer than {INSTALL_S:g} s"
    except subprocess.CalledProcessError as error:
        return (error.stderr or str(error)).strip().splitlines()[-1]
    return ""


def plans(problem_path: Path, rrt_range: float) -> Iterator[dict[str, Any]]:
    """Return MPlib's answers to the joint problems of a file, with the CPU seconds of each."""
    urdf, srdf = _description(ENVIRONMENT / "so101", built_in("so101").model)
    command = [*map(str, (_python(), PEER, problem_path, urdf, srdf)), "gripper_frame_link", str(rrt_range)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PLAN_S)
    for line in done.stdout.splitlines():
        if line.startswith(MARK):
            yield json.loads(line.removeprefix(MARK))
    if done.returncode != 0:
        print(f"MPlib on {problem_path.name}: {done.stderr.strip().splitlines()[-1]}")


def _python() -> Path:
    return ENVIRONMENT / "bin" / "python"


def _description(folder: Path, robot: RobotModel) -> tuple[Path, Path]:
    """Write the robot as MPlib reads it: its hulls as mesh files instead of the shapes of its URDF."""
    folder.mkdir(parents=True, exist_ok=True)
    root = ET.fromstring(robot.urdf)
    for link in root.iterfind("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
        hull = robot.hulls.get(link.get("name", ""))
        if hull is not None:
            name = f"{link.get('name')}.stl"
            # Of convex meshes it reads this beside the file that is named.
            (folder / f"{name}.convex.stl").write_text(_stl(hull))
            geometry = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
            ET.SubElement(geometry, "mesh", filename=name)
    urdf, srdf = folder / "robot.urdf", folder / "robot.srdf"
    urdf.write_text(ET.tostring(root, encoding="unicode"))
    srdf.write_text(robot.srdf)
    return urdf, srdf


def _stl(hull: Hull) -> str:
    facets = [
        "\n".join(
            ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in corners), "endloop", "endfacet"]
        )
        for corners in hull.vertices[hull.triangles].tolist()
    ]
    return "\n".join(["solid hull", *facets, "endsolid hull"]) + "\n"
