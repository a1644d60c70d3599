from __future__ import annotations

from ipaddress import ip_address

from server.gateway import admission as module
from server.gateway.admission import host_addresses

TABLE = """\
00000000000000000000000000000001 01 80 10 80       lo
fe800000000000000000000000000001 02 40 20 80     eth0
fd000000000000000000000000000002 02 40 00 80     eth0
"""


def test_only_addresses_that_others_can_write_down_are_returned():
    for text in host_addresses():
        address = ip_address(text)
        assert not address.is_loopback
        assert not address.is_link_local


def test_ipv6_addresses_are_those_of_global_scope(monkeypatch):
    monkeypatch.setattr(module, "_read_table", lambda: TABLE)
    monkeypatch.setattr(module, "_ipv4_addresses", lambda: ["10.0.0.2"])
    assert host_addresses() == ["10.0.0.2", "fd00::2"]


def test_a_kernel_without_ipv6_has_none(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "_IPV6_TABLE", tmp_path / "missing")
    assert not any(":" in address for address in host_addresses())
