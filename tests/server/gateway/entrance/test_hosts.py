from __future__ import annotations

import pytest

from server.gateway.entrance.addresses import read_authority
from server.gateway.entrance.hosts import Hosts, own_names


def has(hosts: Hosts, text: str) -> bool:
    host = read_authority(text)
    assert host is not None
    return hosts.has(host)


@pytest.mark.parametrize(
    ("text", "is_ours"),
    [
        ("localhost:9090", True),
        ("LOCALHOST", True),
        ("localhost.", True),
        ("127.0.0.1:9090", True),
        ("[::1]:9090", True),
        ("192.168.0.2", True),
        # Browsers take it for the address, too, and ask nobody.
        ("127.0.0.1.", True),
        ("ROBOT.lab:9090", True),
        ("robot:9090", True),
        ("robot.local", True),
        ("evil.com:9090", False),
        ("localhost.evil.com", False),
        ("127.0.0.1.evil.com", False),
        ("evil.local", False),
        ("lab", False),
    ],
)
def test_the_server_has_its_addresses_and_the_names_of_its_machine(text: str, is_ours: bool) -> None:
    assert has(Hosts(own=own_names("robot.lab")), text) is is_ours


@pytest.mark.parametrize(
    ("allowed", "text", "is_ours"),
    [
        ("arm.example.org", "arm.example.org:1234", True),
        ("Arm.Example.Org", "arm.example.org", True),
        ("arm.example.org:443", "arm.example.org:443", True),
        ("arm.example.org:443", "arm.example.org:444", False),
        ("arm.example.org:443", "arm.example.org", False),
        ("*.example.org", "arm.example.org:9090", True),
        ("*.example.org", "example.org.evil.com", False),
        ("*", "evil.com", True),
    ],
)
def test_further_names_are_allowed_by_pattern(allowed: str, text: str, is_ours: bool) -> None:
    assert has(Hosts([allowed]), text) is is_ours


def test_a_machine_has_its_name_and_that_of_multicast_dns() -> None:
    assert own_names("Robot.lab.example") == ("robot.lab.example", "robot", "robot.local")
    assert own_names("robot") == ("robot", "robot", "robot.local")
    assert own_names("") == ()
    assert own_names()
