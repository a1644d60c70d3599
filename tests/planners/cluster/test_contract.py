from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from planners.cluster import contract as contract_module
from planners.cluster.contract import contract

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    contract.cache_clear()
    yield
    contract.cache_clear()


def test_it_names_the_version_and_a_digest() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\S+ \(planners [0-9a-f]{8}\)", contract())


def test_code_that_differs_makes_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(ROOT / "planners", tmp_path / "planners")
    folders = {"planners": tmp_path / "planners", "robot": ROOT / "robot"}
    monkeypatch.setattr(contract_module.resources, "files", folders.__getitem__)
    copied = contract()
    contract.cache_clear()
    with (tmp_path / "planners" / "ik" / "__init__.py").open("a") as file:
        file.write("\n")
    assert contract() != copied
