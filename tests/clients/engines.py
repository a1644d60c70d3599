"""What the engine-free parts of the clients for Unity and Unreal have in common, each asked through its driver."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest

from harness.server import ROOT
from tests.test_docs import rotation
from tests.test_readme import blocks

# Gives lines to a driver, and returns the lines of its output.
Answers = Callable[..., list[str]]


class Driven(Protocol):
    """An arm that is moved by the lines of a driver."""

    def give(self, line: str) -> None: ...

    def until(self, beginning: str) -> str: ...


def goes_round(arm: Driven, *, tip: str, far: str, gripped: str) -> None:
    """Move an arm by name, joint, tip and gripper, to where it cannot go, and stop it midway."""
    for goal in ("named ready", "joint shoulder_pan 0.5", f"tip {tip}"):
        arm.give(goal)
        assert arm.until("goal") == "1 the arm is there", goal
    arm.give("gripper 1.0")
    assert arm.until("gripper") == gripped
    arm.give(f"tip {far}")
    assert arm.until("goal").startswith("-31 ")
    arm.give("joint shoulder_pan -0.5")
    arm.give("stop")
    assert arm.until("goal").startswith("-7 ")
    # A goal that another one replaces is not taken for the end of the latest.
    arm.give("named ready")
    arm.give("named rest")
    assert arm.until("goal") == "1 the arm is there"


def connects_as_documented(answers: Answers) -> None:
    """A connection begins with messages of docs/engines.md; delays between attempts double up to ten seconds."""
    page = [json.loads(line) for block in blocks(ROOT / "docs" / "engines.md", "json") for line in block.splitlines()]
    frames = [json.loads(line.removeprefix("send ")) for line in answers("setup")]
    assert len(frames) > 5
    assert [frame for frame in frames if frame not in page] == []
    assert [line.split()[1] for line in answers("delays")] == ["0.5", "1", "2", "4", "8", "10", "10"]


def turns_coordinates(answers: Answers, axes: np.ndarray, units_per_m: float) -> None:
    """Coordinates are those of ROS by a matrix, also back."""
    random = np.random.default_rng(0)
    position, quaternion = random.normal(size=3), random.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    p, q = (" ".join(map(str, each)) for each in (position, quaternion))
    there, back, turned = map(floats, answers(f"position {p}", f"position_back {p}", f"rotation {q}"))
    assert there == pytest.approx(axes @ position / units_per_m)
    assert back == pytest.approx(axes.T @ position * units_per_m)
    matrix = np.asarray(rotation(list(quaternion)))
    assert np.asarray(rotation(list(turned))) == pytest.approx(axes @ matrix @ axes.T, abs=1e-9)


def floats(line: str) -> np.ndarray:
    return np.array([float(word) for word in line.split()[1:]])


def stl(triangles: int) -> bytes:
    return bytes(80) + struct.pack("<I", triangles) + bytes(50 * triangles)


def refuses_a_cut_stl(answers: Answers, folder: Path, other: bytes, reason: str) -> None:
    """A binary STL is read, and one that is cut off is refused with its sizes; another one with its reason."""
    for name, octets in (("whole", stl(2)), ("cut", stl(2)[:-1]), ("other", other)):
        (folder / f"{name}.stl").write_bytes(octets)
    assert answers(*(f"stl {folder / name}.stl" for name in ("whole", "cut", "other"))) == [
        "corners 18",
        "error no binary STL: 2 triangles need 184 bytes, the file has 183",
        reason,
    ]
