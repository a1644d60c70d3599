"""Taught motions by name, and their files."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from server.errors import ServiceError
from server.teaching import taught_motion
from server.teaching.taught_motion import MotionFiles, TaughtMotion
from tests.helpers.moveit import ROBOT

WAVE = TaughtMotion(("elbow_flex", "gripper"), np.array([0.0, 0.5, 1.25]), np.array([[0.0, 1.0], [0.2, 1.0], [0.1, 0]]))


@pytest.fixture
def motions(tmp_path: Path) -> MotionFiles:
    return MotionFiles(tmp_path / "motions", ROBOT)


async def test_a_saved_motion_is_the_same_for_the_next_server(motions: MotionFiles, tmp_path: Path) -> None:
    await motions.save("Küche 1", WAVE)
    again = await MotionFiles(tmp_path / "motions", ROBOT).load("Küche 1")
    assert again.joint_names == WAVE.joint_names
    assert again.time_s.tolist() == WAVE.time_s.tolist()
    assert again.positions_rad.tolist() == WAVE.positions_rad.tolist()


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".x", " a", "a ", "x" * 51, "\0", "a\nb"])
async def test_a_name_that_is_no_file_is_refused_with_the_limit(motions: MotionFiles, name: str) -> None:
    await motions.save("a", WAVE)
    for change in (motions.load(name), motions.save(name, WAVE), motions.delete(name), motions.check_new(name)):
        with pytest.raises(ServiceError, match=r"^name: must be 1 to 50"):
            await change
    with pytest.raises(ServiceError, match=r"^new_name: must be 1 to 50"):
        await motions.rename("a", name)


async def test_an_unknown_motion_is_refused_with_the_known_ones(motions: MotionFiles) -> None:
    with pytest.raises(ServiceError, match="no motion is saved"):
        await motions.load("wave")
    await motions.save("a", WAVE)
    for change in (motions.load("wave"), motions.delete("wave"), motions.rename("wave", "b")):
        with pytest.raises(ServiceError, match="saved are: a"):
            await change


async def test_a_taken_name_is_neither_recorded_nor_renamed_to(motions: MotionFiles) -> None:
    for name in ("a", "b"):
        await motions.save(name, WAVE)
    with pytest.raises(ServiceError, match="delete or rename it"):
        await motions.check_new("a")
    with pytest.raises(ServiceError, match="there is a motion 'b' already"):
        await motions.rename("a", "b")


async def test_the_number_of_motions_is_bounded_also_when_several_are_saved_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(taught_motion, "MAX_MOTIONS", 2)
    motions = MotionFiles(tmp_path, ROBOT)
    saved = await asyncio.gather(*(motions.save(name, WAVE) for name in "abcd"), return_exceptions=True)
    assert sum(isinstance(each, ServiceError) for each in saved) == 2
    names = await motions.names()
    assert len(names) == 2
    await motions.save(names[0], WAVE)
    with pytest.raises(ServiceError, match="2 motions are saved already, the limit is 2"):
        await motions.check_new("e")


GOOD = {"joint_names": ["elbow_flex"], "time_s": [0.0, 1.0], "positions_rad": [[0.0], [0.1]]}


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        {**GOOD, "joint_names": ["knee"]},
        {**GOOD, "joint_names": ["elbow_flex", "elbow_flex"]},
        {**GOOD, "time_s": [0.0]},
        {**GOOD, "time_s": [0.0, 0.0]},
        {**GOOD, "time_s": [0.5, 1.0]},
        {**GOOD, "time_s": [0.0, 601.0]},
        {**GOOD, "positions_rad": [[0.0]]},
        {**GOOD, "positions_rad": [[0.0], [0.1, 0.2]]},
        '{"joint_names": ["elbow_flex"], "time_s": [0.0, 1.0], "positions_rad": [[0.0], [NaN]]}',
    ],
)
async def test_a_file_that_holds_no_motion_of_this_arm_is_refused_with_its_path(
    motions: MotionFiles, tmp_path: Path, content: Any
) -> None:
    await motions.save("wave", WAVE)
    file = tmp_path / "motions" / "wave.json"
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ServiceError, match=r"wave\.json"):
        await motions.load("wave")
