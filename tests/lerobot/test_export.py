"""lerobot opens datasets that the server has exported, and ``armbridge-dataset`` edits them.

lerobot needs torch, and an environment of its own: ``make test-lerobot`` makes it and runs this.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.lerobot.test_robot import SCENARIO, lerobot, pytestmark
from tests.server.datasets.conftest import in_order
from tests.server.datasets.test_export import MARKED, exported
from tests.server.recordings import record

__all__ = ["pytestmark"]


def edit(*commands: tuple[object, ...]) -> list[Any]:
    """Carry out commands of armbridge-dataset, or open a dataset; return what each has printed."""
    arguments = json.dumps([[str(each) for each in command] for command in commands])
    printed = lerobot("python", SCENARIO, "edit", arguments)
    return [json.loads(line) for line in printed.splitlines() if line.startswith(("{", "["))]


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    exported(tmp_path / "data", record(tmp_path / "run.mcap", in_order(MARKED)))
    return tmp_path / "data"


def test_a_dataset_with_its_video_is_merged_resumed_added_to_and_loses_episodes(dataset: Path, tmp_path: Path) -> None:
    both = tmp_path / "both"
    first, merged, listed, deleted, left, resumed, added, more = edit(
        ("open", dataset),
        ("merge", dataset, dataset, "--output", both),
        ("list", both),
        ("delete", both, 0, 2, 0),
        ("open", both),
        ("resume", both),
        ("open", both),
        ("add", dataset, both),
        ("open", dataset),
    )
    assert first == {"episodes": 2, "frames": 27, "task": "drop it", "image": [3, 24, 32]}
    assert merged[:2] == [0, [f"{both}: 4 episodes of 2 datasets"]]
    total = f"{both}: 4 episodes, 5.4 s at 10 Hz, observation.images.camera"
    pick, drop = "1.1 s, pick the cube", "1.6 s, drop it"
    assert listed[:2] == [0, [f"0: {pick}", f"1: {drop}", f"2: {pick}", f"3: {drop}", total]]
    assert deleted[:2] == [0, [f"{both}: 2 episodes deleted, 2 are left"]]
    assert left == {**first, "frames": 32}
    assert resumed == {**left, "episodes": 3, "frames": 37}
    assert added[:2] == [0, [f"{dataset}: 5 episodes of 2 datasets"]]
    assert more == {**first, "episodes": 5, "frames": 64}
    assert (both / "meta/armbridge.json").read_text() == (dataset / "meta/armbridge.json").read_text()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["both", "data", "run.mcap"]


def test_what_cannot_be_edited_is_refused_with_a_sentence_and_stays(dataset: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    exported(other, record(tmp_path / "other.mcap", in_order(MARKED)))
    arm = json.loads((other / "meta/armbridge.json").read_text())
    (other / "meta/armbridge.json").write_text(json.dumps({**arm, "units": "lerobot"}))
    (tmp_path / "x_old").mkdir()
    attempts = {
        ("list", tmp_path): f"{tmp_path}: is no dataset of lerobot: it has no meta/info.json",
        ("delete", dataset, 5): f"{dataset}: has the episodes 0 to 1, not 5",
        ("delete", dataset, 1, 0): f"{dataset}: a dataset must keep an episode; delete the folder instead",
        ("merge", dataset, dataset, "--output", dataset): f"{dataset} exists already: name another folder (--output)",
        ("add", dataset, other): f"has another units than in {dataset}",
        ("merge", dataset, dataset, "--output", tmp_path / "x"): f"{tmp_path}/x_old: is left from an edit",
        ("merge", dataset, other, "--output", tmp_path / "y"): f"has another units than in {dataset}",
    }
    *refused, left = edit(*attempts, ("open", dataset))
    for (code, out, errors), sentence in zip(refused, attempts.values(), strict=True):
        assert (code, out) == (1, [])
        assert sentence in errors[0]
    assert left["episodes"] == 2
