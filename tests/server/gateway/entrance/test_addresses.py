from __future__ import annotations

import pytest

from server.gateway.entrance.addresses import Authority, is_loopback, matches, peer, read_authority


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("localhost", Authority("localhost")),
        ("LocalHost:9090", Authority("localhost", 9090)),
        ("robot.lab.", Authority("robot.lab")),
        ("127.0.0.1:80", Authority("127.0.0.1", 80)),
        ("[::1]", Authority("::1")),
        ("[0:0:0:0:0:0:0:1]:9090", Authority("::1", 9090)),
        ("[fe80::1%eth0]:9090", Authority("fe80::1", 9090)),
        ("my_robot:9090", Authority("my_robot", 9090)),
    ],
)
def test_a_host_is_read_with_its_port(text: str, read: Authority) -> None:
    assert read_authority(text) == read


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":9090",
        "localhost:",
        "localhost:x",
        "localhost:65536",
        "localhost:9090:1",
        "user@localhost",
        "localhost:9090@evil.com",
        "localhost/",
        "localhost#evil.com",
        "localhost\\evil.com",
        "local host",
        " localhost",
        "localhost\n",
        "::1",
        "[::1",
        "[127.0.0.1]",
        "[::x]",
        "localhost..",
        ".",
        "löcalhost",
        "localhost,evil.com",
        "a" * 256,
    ],
)
def test_what_is_no_host_is_none(text: str) -> None:
    assert read_authority(text) is None


@pytest.mark.parametrize(
    ("host", "is_ours"),
    [
        ("localhost", True),
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("[::1]", True),
        ("localhost.evil.com", False),
        ("127.0.0.1.evil.com", False),
        ("0.0.0.0", False),
        ("192.168.0.2", False),
    ],
)
def test_only_this_machine_is_loopback(host: str, is_ours: bool) -> None:
    authority = read_authority(host)
    assert authority is not None
    assert authority.is_loopback is is_ours


def test_an_address_is_loopback_or_not_whatever_its_family() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("fe80::1%eth0")
    assert not is_loopback("somewhere")


def test_a_network_of_ipv6_is_one_peer_and_ipv4_is_the_same_in_both_families() -> None:
    assert peer("2001:db8::1") == peer("2001:db8::ffff:2") != peer("2001:db8:0:1::1")
    assert peer("::ffff:192.0.2.1") == peer("192.0.2.1") != peer("192.0.2.2")
    assert peer("fe80::1%eth0") == peer("fe80::2%eth1")
    assert peer("::1") != peer("::2")
    assert peer("unknown") == "unknown"


def test_in_a_pattern_only_the_asterisk_is_special() -> None:
    assert matches("https://a.lab", "https://*.lab")
    assert matches("http://[2001:db8::1]", "http://[2001:db8::1]")
    assert not matches("http://2", "http://[2001:db8::1]")
    assert not matches("https://a.lab.evil.com", "https://*.lab")
