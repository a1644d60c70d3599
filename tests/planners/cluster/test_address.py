from __future__ import annotations

import pytest

from planners.cluster.address import scheduler_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("dask://planner.lab:8786", "tcp://planner.lab:8786"),
        ("dask+tls://10.0.0.2:8786/", "tls://10.0.0.2:8786"),
        ("dask://[::1]:1", "tcp://[::1]:1"),
    ],
)
def test_an_address_is_told_as_dask_takes_it(text: str, address: str) -> None:
    assert scheduler_address(text) == address


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("tcp://host:8786", "must begin with dask:// or dask[+]tls://"),
        ("many", "must begin with"),
        ("dask://host", "port of 1 to 65535"),
        ("dask://host:0", "port of 1 to 65535"),
        ("dask://:8786", "HOST:PORT"),
        ("dask://host:65536", "no address"),
        ("dask://host:x", "no address"),
        ("dask://me@host:1", "nothing else"),
        ("dask://host:1/path", "nothing else"),
        ("dask://host:1?x=1", "nothing else"),
        ("dask://[::1:1", "no address"),
    ],
)
def test_what_is_no_address_is_refused_with_what_it_must_be(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        scheduler_address(text)
