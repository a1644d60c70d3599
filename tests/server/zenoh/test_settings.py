from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from server.config_loader import load
from server.errors import ConfigurationError
from server.zenoh.settings import ZenohSettings, check_installed, exposed_endpoint, is_endpoint, session_config
from tests.helpers.server import ROOT
from tests.test_readme import blocks

# Settings.

PAGE = ROOT / "docs" / "zenoh.md"


def refusal(**settings: Any) -> str:
    with pytest.raises(ValidationError) as refused:
        ZenohSettings(**settings)
    return str(refused.value)


def test_nothing_is_shared_and_nothing_comes_in_unless_it_is_asked_for() -> None:
    settings = ZenohSettings()
    assert settings.mode == "off"
    assert (settings.listen, settings.subscribe, settings.offer, settings.call) == ((), (), (), ())


def test_no_topic_that_moves_the_arm_goes_out_by_itself() -> None:
    assert not [pattern for pattern in ZenohSettings().publish if pattern in ("*", "/*", "/moveit_goal_*")]


@pytest.mark.parametrize("endpoint", ["192.168.1.2:7447", "tcp", ""])
def test_an_endpoint_without_a_protocol_is_refused(endpoint: str) -> None:
    assert "must be protocol/address, as in tcp/127.0.0.1:7447" in refusal(connect=(endpoint,))


@pytest.mark.parametrize("namespace", ["arm1", "/arm1/", "/", "/arm 1", "/*"])
def test_a_namespace_that_is_no_name_is_refused(namespace: str) -> None:
    assert "as in /arm1" in refusal(namespace=namespace)


def test_a_client_without_a_router_is_refused() -> None:
    assert "mode client needs connect" in refusal(mode="client")


@pytest.mark.parametrize("settings", blocks(PAGE, "toml"))
def test_the_settings_on_the_page_are_taken(settings: str, tmp_path: Path) -> None:
    file = tmp_path / "armbridge.toml"
    file.write_text(settings)
    taken = load(file, {}).zenoh
    assert taken.mode != "off"
    session_config(taken)


# zenoh's configuration.


def value(settings: ZenohSettings, path: str) -> Any:
    return json.loads(session_config(settings).get_json(path))


def test_a_server_listens_nowhere_unless_told() -> None:
    assert value(ZenohSettings(mode="peer"), "listen/endpoints") == []
    assert value(ZenohSettings(mode="peer"), "scouting/multicast/enabled") is False


def test_a_machine_that_reads_no_responses_is_let_go_soon() -> None:
    path = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    assert value(ZenohSettings(mode="peer"), path) == 1_000_000


def test_the_settings_become_the_configuration_of_zenoh() -> None:
    connect, listen = ("tcp/127.0.0.1:7447",), ("tcp/127.0.0.1:7448",)
    settings = ZenohSettings(mode="router", connect=connect, listen=listen, scouting_multicast=True)
    assert value(settings, "mode") == "router"
    assert value(settings, "connect/endpoints") == list(connect)
    assert value(settings, "listen/endpoints") == list(listen)
    assert value(settings, "scouting/multicast/enabled") is True


def test_a_file_of_zenoh_says_what_no_setting_says(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{ /* ours */ connect: { endpoints: ["tls/router:7447"] }, queries_default_timeout: 1234, }')
    settings = ZenohSettings(mode="peer", config_file=file)
    assert value(settings, "connect/endpoints") == ["tls/router:7447"]
    assert value(settings, "queries_default_timeout") == 1234
    assert value(settings, "listen/endpoints") == []


def test_a_file_of_zenoh_may_say_where_to_listen(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{ listen: { endpoints: ["tcp/127.0.0.1:7449"] } }')
    assert value(ZenohSettings(mode="peer", config_file=file), "listen/endpoints") == ["tcp/127.0.0.1:7449"]


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
    exposed: dict[str, Any] = {"mode": "peer", "listen": ("tcp/0.0.0.0:7447",), **taken_in}
    with pytest.raises(ConfigurationError, match=r"^zenoh\.listen: tcp/0\.0\.0\.0:7447 lets .*zenoh\.insecure = true$"):
        session_config(ZenohSettings(**exposed))
    session_config(ZenohSettings(**exposed, insecure=True))


def test_the_state_of_the_arm_may_be_told_to_everyone() -> None:
    session_config(ZenohSettings(mode="peer", listen=("tcp/0.0.0.0:7447",)))


@pytest.mark.parametrize(
    "listening", ['["tcp/0.0.0.0:7449"]', '{ peer: ["tcp/0.0.0.0:7449"] }', '["tls/0.0.0.0:7449"]']
)
def test_an_endpoint_opened_by_a_file_of_zenoh_counts_as_exposed(tmp_path: Path, listening: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(f"{{ listen: {{ endpoints: {listening} }} }}")
    with pytest.raises(ConfigurationError, match=r"0\.0\.0\.0:7449 lets everyone"):
        session_config(ZenohSettings(mode="peer", config_file=file, offer=("/arm/*",)))


def test_machines_that_show_a_certificate_may_send_commands(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ transport: { link: { tls: { enable_mtls: true } } } }")
    session_config(ZenohSettings(mode="peer", config_file=file, listen=("tls/0.0.0.0:7449",), offer=("/arm/*",)))


def test_a_missing_zenoh_is_reported_with_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigurationError, match=r"zenoh\.mode: peer needs .* pip install 'armbridge\[zenoh\]'"):
        check_installed(ZenohSettings(mode="peer"))
    check_installed(ZenohSettings())


# Endpoints.


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/127.0.0.1:7447", "udp/127.3.2.1:7447", "tcp/[::1]:7447", "tcp/localhost:7447", "unixsock-stream//s"],
)
def test_only_this_machine_reaches_itself(endpoint: str) -> None:
    assert exposed_endpoint([endpoint], mutual_tls=False) is None


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.2:7447", "tcp/arm.local:7447", "tls/0.0.0.0:7447", "?"],
)
def test_everybody_reaches_other_addresses(endpoint: str) -> None:
    assert exposed_endpoint(["tcp/127.0.0.1:1", endpoint], mutual_tls=False) == endpoint


def test_certificates_guard_encrypted_links_alone() -> None:
    assert exposed_endpoint(["tls/0.0.0.0:7447", "quic/0.0.0.0:7447"], mutual_tls=True) is None
    assert exposed_endpoint(["tcp/0.0.0.0:7447"], mutual_tls=True) == "tcp/0.0.0.0:7447"


def test_without_endpoints_nothing_is_exposed() -> None:
    assert exposed_endpoint([], mutual_tls=False) is None


def test_an_endpoint_has_a_protocol() -> None:
    assert is_endpoint("tcp/127.0.0.1:7447")
    assert not is_endpoint("127.0.0.1:7447")
