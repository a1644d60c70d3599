"""Files of the data directory that older and newer versions have written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from server.graph.message_types import MessageTypes
from server.moveit.named_states import NamedStatesFile
from server.moveit.scene.saved_scene import complete_scene
from server.teaching.motion_files import MotionFiles
from tests.helpers.clock import FakeClock
from tests.helpers.moveit import REGISTRY, ROBOT

# As version 0.1.0 has written them.
STATES: dict[str, Any] = {"states": {"tray": {"shoulder_pan": 0.25, "elbow_flex": -0.5}}}
MOTION: dict[str, Any] = {
    "joint_names": ["shoulder_pan"],
    "time_s": [0.0, 0.5, 1.0],
    "positions_rad": [[0.0], [0.1], [0.2]],
}
BOX = {
    "header": {"frame_id": "world"},
    "id": "box",
    "pose": {"position": {"x": 0.3, "y": 0.0, "z": 0.1}, "orientation": {"w": 1.0}},
    "primitives": [{"type": 1, "dimensions": [0.1, 0.1, 0.1]}],
    "primitive_poses": [{"position": {}, "orientation": {"w": 1.0}}],
}

# What a newer version may have added.
NEWER = {"written_by": "9.9.9"}


@pytest.mark.parametrize("added", [{}, NEWER], ids=["of 0.1.0", "of a newer version"])
async def test_states_and_motions_open(tmp_path: Path, added: dict[str, Any]) -> None:
    states = tmp_path / "named_states.json"
    states.write_text(json.dumps({**STATES, **added}))
    assert NamedStatesFile(states).load() == STATES["states"]
    (tmp_path / "wave.json").write_text(json.dumps({**MOTION, **added}))
    motion = await MotionFiles(tmp_path, ROBOT).load("wave")
    assert motion.positions_rad.tolist() == MOTION["positions_rad"]


def test_the_scene_of_an_older_version_opens() -> None:
    scene = complete_scene(MessageTypes(REGISTRY, FakeClock()), {"world": {"collision_objects": [BOX]}})
    assert [each["id"] for each in scene["world"]["collision_objects"]] == ["box"]


def test_states_of_an_unknown_kind_are_set_aside_and_kept(tmp_path: Path) -> None:
    states = tmp_path / "named_states.json"
    states.write_text('{"states": [{"name": "tray"}]}')
    assert NamedStatesFile(states).load() == {}
    assert (tmp_path / "named_states.json.broken").read_text() == '{"states": [{"name": "tray"}]}'
