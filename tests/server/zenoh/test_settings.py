import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from harness.server import ROOT
from server.config_loader import load
from server.errors import ConfigurationError
from server.zenoh.settings import ZenohSettings, check_installed, exposed_endpoint, session_config
from tests.test_readme import blocks

PAGE = ROOT / "docs" / "zenoh.md"

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    **{f"namespace {name}": ({"namespace": name}, "as in /arm1") for name in ("arm1", "/arm1/", "/", "/arm 1", "/*")},
    "client without a router": ({"mode": "client"}, "mode client needs connect"),
}


def test_a_setting_that_cannot_be_is_refused_with_an_example() -> None:
    for case, (settings, sentence) in REFUSED.items():
        with pytest.raises(ValidationError) as refused:
            ZenohSettings(**settings)
        assert sentence in str(refused.value), case


def test_by_itself_nothing_comes_in_and_no_command_goes_out() -> None:
    settings = ZenohSettings()
    assert settings.mode == "off"
    assert (settings.listen, settings.subscribe, settings.offer, settings.call) == ((), (), (), ())
    assert not [pattern for pattern in ZenohSettings().publish if pattern in ("*", "/*", "/moveit_goal_*")]


def test_the_settings_on_the_page_are_taken(tmp_path: Path) -> None:
    file = tmp_path / "armbridge.toml"
    for settings in blocks(PAGE, "toml"):
        file.write_text(settings)
        taken = load(file, {}).zenoh
        assert taken.mode != "off", settings
        session_config(taken)


def with_file(folder: Path, text: str, **settings: Any) -> ZenohSettings:
    """Settings with a configuration file of zenoh."""
    (folder / "zenoh.json5").write_text(text)
    return ZenohSettings(mode="peer", config_file=folder / "zenoh.json5", **settings)


def value(settings: ZenohSettings, path: str) -> Any:
    return json.loads(session_config(settings).get_json(path))


def test_the_settings_and_a_file_of_zenoh_become_its_configuration(tmp_path: Path) -> None:
    told: dict[str, Any] = {"connect": ("tcp/127.0.0.1:7447",), "listen": ("tcp/127.0.0.1:7448",)}
    settings = ZenohSettings(mode="router", **told)
    assert value(settings, "mode") == "router"
    for name, endpoints in told.items():
        assert value(settings, f"{name}/endpoints") == list(endpoints)
    # Nothing of it happens unless it is set.
    assert value(ZenohSettings(mode="peer"), "listen/endpoints") == []
    assert value(ZenohSettings(mode="peer"), "scouting/multicast/enabled") is False
    text = '{ /* ours */ connect: { endpoints: ["tls/router:7447"] }, scouting: { multicast: { enabled: true } }, }'
    settings = with_file(tmp_path, text)
    assert value(settings, "connect/endpoints") == ["tls/router:7447"]
    assert value(settings, "scouting/multicast/enabled") is True
    assert value(settings, "listen/endpoints") == []
    listening = with_file(tmp_path, '{ listen: { endpoints: ["tcp/127.0.0.1:7449"] } }')
    assert value(listening, "listen/endpoints") == ["tcp/127.0.0.1:7449"]


@pytest.mark.parametrize("text", ["{ nonsense: 1 }", "{", None])
def test_a_file_that_zenoh_cannot_read_is_refused_with_its_name(tmp_path: Path, text: str | None) -> None:
    file = tmp_path / "zenoh.json5"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigurationError, match=r"^zenoh\.config_file: .*zenoh\.json5: (?!.*cargo)"):
        session_config(ZenohSettings(mode="peer", config_file=file))


def test_an_endpoint_that_zenoh_refuses_is_named() -> None:
    with pytest.raises(ConfigurationError) as refused:
        session_config(ZenohSettings(mode="peer", connect=("tcp/",)))
    assert str(refused.value) == (
        "zenoh: connect/endpoints = ('tcp/',) is refused: Endpoints must be of the form "
        "<protocol>/<address>[?<metadata>][#<config>]: tcp/"
    )


@pytest.mark.parametrize("taken_in", [{"subscribe": ("/moveit_goal_*",)}, {"offer": ("/arm/*",)}])
def test_commands_from_everyone_in_the_network_must_be_asked_for_twice(taken_in: dict[str, Any]) -> None:
    exposed: dict[str, Any] = {"mode": "peer", "listen": ("tcp/0.0.0.0:7447",)}
    with pytest.raises(ConfigurationError, match=r"^zenoh\.listen: tcp/0\.0\.0\.0:7447 lets .*zenoh\.insecure = true$"):
        session_config(ZenohSettings(**exposed, **taken_in))
    session_config(ZenohSettings(**exposed, **taken_in, insecure=True))
    # The state of the arm may be told to everyone.
    session_config(ZenohSettings(**exposed))


def test_an_endpoint_opened_by_a_file_of_zenoh_counts_as_exposed_unless_a_certificate_is_needed(tmp_path: Path) -> None:
    for endpoints in ('["tcp/0.0.0.0:7449"]', '{ peer: ["tcp/0.0.0.0:7449"] }', '["tls/0.0.0.0:7449"]'):
        settings = with_file(tmp_path, f"{{ listen: {{ endpoints: {endpoints} }} }}", offer=("/arm/*",))
        with pytest.raises(ConfigurationError, match=r"0\.0\.0\.0:7449 lets everyone"):
            session_config(settings)
    mutual = "{ transport: { link: { tls: { enable_mtls: true } } } }"
    session_config(with_file(tmp_path, mutual, listen=("tls/0.0.0.0:7449",), offer=("/arm/*",)))


def test_a_missing_zenoh_is_reported_with_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigurationError, match=r"zenoh\.mode: peer needs .* pip install 'armbridge\[zenoh\]'"):
        check_installed(ZenohSettings(mode="peer"))
    check_installed(ZenohSettings())


HERE = ["tcp/127.0.0.1:7447", "udp/127.3.2.1:7447", "tcp/[::1]:7447", "tcp/localhost:7447", "unixsock-stream//s"]
OF_EVERYBODY = [f"tcp/{host}:7447" for host in ("0.0.0.0", "[::]", "192.168.1.2", "arm.local")]


def test_exposed_endpoints_are_found_unless_certificates_guard_them() -> None:
    assert exposed_endpoint(HERE, mutual_tls=False) is None
    for endpoint in (*OF_EVERYBODY, "tls/0.0.0.0:7447", "?"):
        assert exposed_endpoint([*HERE, endpoint], mutual_tls=False) == endpoint
    assert exposed_endpoint(["tls/0.0.0.0:7447", "quic/0.0.0.0:7447"], mutual_tls=True) is None
    assert exposed_endpoint(["tcp/0.0.0.0:7447"], mutual_tls=True) == "tcp/0.0.0.0:7447"
