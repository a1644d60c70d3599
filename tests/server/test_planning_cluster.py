from __future__ import annotations

import signal
from pathlib import Path

import pytest

from planners.cluster.cluster import TlsFiles
from planners.pool import PlannerPool
from robot.description import model
from server import planning_cluster as module
from server.errors import ConfigurationError
from server.planning_cluster import planning_cluster
from server.planning_settings import PlanningSettings
from tests.helpers.server import RunningServer, free_port

ROBOT = model.builtin()


def made(settings: PlanningSettings) -> module.Cluster | None:
    return planning_cluster(settings, ROBOT, PlannerPool(ROBOT))


def test_without_a_cluster_in_the_settings_there_is_none() -> None:
    assert made(PlanningSettings()) is None


def test_a_cluster_without_its_package_is_refused_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"planning.workers: dask://host:1 .*pip install 'armbridge\[dask\]'"):
        made(PlanningSettings(workers="dask://host:1"))


def test_a_certificate_that_cannot_be_read_is_refused_before_the_start(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    files = TlsFiles(*(tmp_path / name for name in ("ca.pem", "cert.pem", "key.pem")))
    settings = PlanningSettings(
        workers="dask+tls://host:1",
        tls_authority=files.authority,
        tls_certificate=files.certificate,
        tls_key=files.key,
    )
    files.authority.write_text("")
    with pytest.raises(ConfigurationError, match=r"planning.tls_certificate: .*cert.pem"):
        made(settings)
    files.certificate.write_text("")
    files.key.write_text("")
    cluster = made(settings)
    assert cluster is not None
    assert cluster._tls == files


def test_a_server_whose_cluster_is_not_there_says_so_and_stops_as_fast_as_ever() -> None:
    pytest.importorskip("distributed")
    settings = {"ARMBRIDGE_PLANNING__WORKERS": f"dask://127.0.0.1:{free_port()}"}
    with RunningServer(settings=settings) as server:
        assert server.has_logged("planning goes on here", 30.0)
        code, took_s = server.end(signal.SIGTERM)
    assert code == 0
    assert took_s < 3.0
