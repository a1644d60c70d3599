from __future__ import annotations

import pytest

from server.config_reading import load
from server.errors import ConfigurationError


def test_a_number_from_the_environment_is_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_PLANNING__WORKERS", "4")
    assert load(None, {}).planning.workers == 4


@pytest.mark.parametrize(
    ("workers", "words"),
    [
        (0, "greater than or equal to 1"),
        (17, "less than or equal to 16"),
        ("17", "16"),
        ("-1", "1"),
        ("many", "integer"),
    ],
)
def test_a_number_out_of_range_is_refused(workers: int | str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=f"planning.workers: .*{words}"):
        load(None, {"planning": {"workers": workers}})


@pytest.mark.parametrize("workers", ["dask://host:8786", "dask+tls://host:8786"])
def test_a_cluster_is_refused_with_the_command_that_plans_there(workers: str) -> None:
    with pytest.raises(
        ConfigurationError, match=r"planning.workers: must be 1 to 16: .*armbridge plan FILE --scheduler"
    ):
        load(None, {"planning": {"workers": workers}})
