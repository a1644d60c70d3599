from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from server.config_loader import load
from server.zenoh.session_config import session_config
from server.zenoh.settings import ZenohSettings
from tests.helpers.server import ROOT
from tests.test_readme import blocks

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
