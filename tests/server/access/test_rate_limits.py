from __future__ import annotations

from server.access.rate_limits import RateLimiter, client_key, is_loopback


def test_in_the_long_run_so_many_a_second() -> None:
    rate = RateLimiter(2.0, 1)
    assert [rate.take(100.0 + step / 10) for step in range(11)] == [step % 5 == 0 for step in range(11)]


def test_a_long_rest_saves_up_a_burst_and_no_more() -> None:
    rate = RateLimiter(1.0, 2)
    assert [rate.take(1e6) for _ in range(3)] == [True, True, False]


def test_an_address_is_loopback_or_not_whatever_its_family() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("fe80::1%eth0")
    assert not is_loopback("somewhere")


def test_a_network_of_ipv6_is_one_peer_and_ipv4_is_the_same_in_both_families() -> None:
    assert client_key("2001:db8::1") == client_key("2001:db8::ffff:2") != client_key("2001:db8:0:1::1")
    assert client_key("::ffff:192.0.2.1") == client_key("192.0.2.1") != client_key("192.0.2.2")
    assert client_key("fe80::1%eth0") == client_key("fe80::2%eth1")
    assert client_key("::1") != client_key("::2")
    assert client_key("unknown") == "unknown"
