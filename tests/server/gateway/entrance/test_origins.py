from __future__ import annotations

import pytest

from server.gateway.entrance.addresses import read_authority
from server.gateway.entrance.origins import Origins


def has(origin: str, *allowed: str, host: str = "robot.lab:9090", encrypted: bool = False) -> bool:
    authority = read_authority(host)
    assert authority is not None
    return Origins(allowed).has(origin, authority, encrypted=encrypted)


@pytest.mark.parametrize(
    "origin",
    [
        "http://localhost",
        "http://localhost:3000",
        "https://LOCALHOST:8443",
        "http://127.0.0.1:8000",
        "http://127.8.9.1",
        "http://[::1]:5173",
    ],
)
def test_pages_of_this_machine_may_connect_whatever_their_port(origin: str) -> None:
    assert has(origin)


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.com",
        "https://evil.com:9090",
        "http://localhost.evil.com",
        "http://127.0.0.1.evil.com",
        "http://localhost@evil.com",
        "http://evil.com#localhost",
        "http://evil.com/localhost",
        "http://localhost:3000/",
        "http://localhost:3000/page",
        "http://192.168.0.2",
        "http://0.0.0.0:9090",
        "null",
        "file://",
        "",
        "localhost",
        "//localhost",
        "ftp://localhost",
        "chrome-extension://localhost",
        "http://localhost http://evil.com",
    ],
)
def test_other_pages_may_not(origin: str) -> None:
    assert not has(origin)


@pytest.mark.parametrize(
    ("origin", "host", "encrypted", "own"),
    [
        ("http://robot.lab:9090", "robot.lab:9090", False, True),
        ("http://Robot.Lab:9090", "robot.lab.:9090", False, True),
        ("http://robot.lab", "robot.lab:80", False, True),
        ("http://robot.lab:80", "robot.lab", False, True),
        ("https://robot.lab", "robot.lab:443", True, True),
        ("http://[fd00::1]:9090", "[fd00:0::1]:9090", False, True),
        ("http://robot.lab", "robot.lab:9090", False, False),
        ("http://robot.lab:9091", "robot.lab:9090", False, False),
        ("https://robot.lab:9090", "robot.lab:9090", False, False),
        ("http://robot.lab:9090", "robot.lab:9090", True, False),
        ("http://evil.com:9090", "robot.lab:9090", False, False),
    ],
)
def test_the_servers_own_page_is_known_by_scheme_host_and_port(
    origin: str, host: str, encrypted: bool, own: bool
) -> None:
    assert has(origin, host=host, encrypted=encrypted) is own


@pytest.mark.parametrize(
    ("allowed", "origin", "may"),
    [
        ("https://app.foxglove.dev", "https://app.foxglove.dev", True),
        ("https://app.foxglove.dev/", "https://APP.foxglove.dev", True),
        ("https://app.foxglove.dev", "http://app.foxglove.dev", False),
        ("https://app.foxglove.dev", "https://app.foxglove.dev.evil.com", False),
        ("https://*.lab.example", "https://a.lab.example", True),
        ("https://*.lab.example", "https://lab.example", False),
        ("null", "null", True),
        ("http*", "null", False),
        ("*", "null", True),
        ("*", "http://evil.com", True),
        ("file://", "file://", True),
    ],
)
def test_further_pages_are_allowed_by_pattern(allowed: str, origin: str, may: bool) -> None:
    assert has(origin, allowed) is may
