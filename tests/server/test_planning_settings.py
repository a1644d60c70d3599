from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from server.config_loader import load
from server.errors import ConfigurationError
from server.planning_settings import PlanningSettings
from tests.test_readme import ROOT, blocks

FILES = {"tls_authority": Path("ca.pem"), "tls_certificate": Path("cert.pem"), "tls_key": Path("key.pem")}


def test_without_a_cluster_all_is_planned_here() -> None:
    settings = PlanningSettings(workers=3)
    assert (settings.active_here, settings.cluster) == (3, None)


def test_beside_a_cluster_the_local_workers_plan() -> None:
    settings = PlanningSettings(workers="dask://host:8786", local_workers=2)
    assert (settings.active_here, settings.cluster) == (2, "tcp://host:8786")


def test_a_number_from_the_environment_is_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_PLANNING__WORKERS", "4")
    assert load(None, {}).planning.workers == 4


@pytest.mark.parametrize("workers", [0, 17, "17", "-1", "many", "dask://host", "http://host:1"])
def test_neither_a_number_in_range_nor_an_address_is_refused_with_what_it_must_be(workers: int | str) -> None:
    with pytest.raises(ConfigurationError, match=r"planning.workers: .*(1 to 16|dask://)"):
        load(None, {"planning": {"workers": workers}})


def test_tls_needs_all_its_files_and_nothing_else_takes_them() -> None:
    assert PlanningSettings(workers="dask+tls://host:1", **FILES).cluster == "tls://host:1"
    with pytest.raises(ValidationError, match="needs tls_certificate, tls_key"):
        PlanningSettings(workers="dask+tls://host:1", tls_authority=FILES["tls_authority"])
    with pytest.raises(ValidationError, match="takes no tls_key"):
        PlanningSettings(workers="dask://host:1", tls_key=FILES["tls_key"])


def test_the_settings_of_the_page_about_clusters_can_be_read(tmp_path: Path) -> None:
    (block,) = blocks(ROOT / "docs" / "cluster.md", "toml")
    file = tmp_path / "armbridge.toml"
    file.write_text(block)
    assert load(file, {}).planning.cluster == "tls://10.0.0.1:8786"
