from __future__ import annotations

from pathlib import Path

import pytest

from server.access.settings import AccessSettings
from server.access.tokens import Tokens
from server.config import ServerSettings
from server.errors import ConfigurationError
from server.gateway.entrance.entrance import Entrance, Pings
from server.gateway.entrance.turnstile import ConnectionLimits
from tests.helpers.certificates import make_pair


def entrance(server: ServerSettings, access: AccessSettings | None = None) -> Entrance:
    access = access or AccessSettings()
    return Entrance.of(server, access, Tokens.of(access))


def test_the_limits_are_those_of_the_settings_and_the_defaults_the_same() -> None:
    server = ServerSettings(max_clients=3, max_clients_per_address=2, connections_per_s=7.0)
    assert entrance(server).limits == ConnectionLimits(3, 2, 7.0)
    assert entrance(ServerSettings()).limits == Entrance().limits == ConnectionLimits()


def test_pings_are_those_of_the_settings_and_the_defaults_the_same() -> None:
    assert entrance(ServerSettings(ping_interval_s=3.0, ping_timeout_s=7.0)).pings == Pings(3.0, 7.0)
    assert entrance(ServerSettings()).pings == Entrance().pings


def test_without_a_certificate_there_is_no_tls(tmp_path: Path) -> None:
    assert entrance(ServerSettings()).tls is None
    pair = make_pair(tmp_path)
    assert entrance(ServerSettings(tls_certificate=pair.certificate, tls_key=pair.key)).tls is not None


def test_a_certificate_that_cannot_be_used_is_told_at_the_start() -> None:
    with pytest.raises(ConfigurationError, match=r"server.tls_certificate: nowhere.pem cannot be read"):
        entrance(ServerSettings(tls_certificate=Path("nowhere.pem"), tls_key=Path("nowhere.pem")))


def test_the_word_for_an_open_address_reaches_the_door() -> None:
    assert entrance(ServerSettings(), AccessSettings(insecure=True)).door.insecure
    assert not entrance(ServerSettings()).door.insecure
