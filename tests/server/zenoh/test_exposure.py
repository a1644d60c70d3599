from __future__ import annotations

import pytest

from server.zenoh.exposure import is_endpoint, open_endpoint


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/127.0.0.1:7447", "udp/127.3.2.1:7447", "tcp/[::1]:7447", "tcp/localhost:7447", "unixsock-stream//s"],
)
def test_only_this_machine_reaches_itself(endpoint: str) -> None:
    assert open_endpoint([endpoint], mutual_tls=False) is None


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.2:7447", "tcp/arm.local:7447", "tls/0.0.0.0:7447", "?"],
)
def test_everybody_reaches_other_addresses(endpoint: str) -> None:
    assert open_endpoint(["tcp/127.0.0.1:1", endpoint], mutual_tls=False) == endpoint


def test_certificates_guard_encrypted_links_alone() -> None:
    assert open_endpoint(["tls/0.0.0.0:7447", "quic/0.0.0.0:7447"], mutual_tls=True) is None
    assert open_endpoint(["tcp/0.0.0.0:7447"], mutual_tls=True) == "tcp/0.0.0.0:7447"


def test_who_listens_nowhere_is_open_to_nobody() -> None:
    assert open_endpoint([], mutual_tls=False) is None


def test_an_endpoint_has_a_protocol() -> None:
    assert is_endpoint("tcp/127.0.0.1:7447")
    assert not is_endpoint("127.0.0.1:7447")
