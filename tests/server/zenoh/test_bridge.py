from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from server.errors import ConfigurationError
from server.zenoh import session_config
from tests.helpers.certificates import Pair, make_pair, make_signed_pair
from tests.helpers.server import ROOT
from tests.helpers.zenoh_network import RosMachine, Site, free_port, until
from tests.test_readme import blocks

STRING = "std_msgs/msg/String"


async def test_servers_find_each_other_in_whichever_order_they_start() -> None:
    port = free_port()
    async with Site(to=(port,), subscribe=("/arm1/*",)) as viewer:
        async with Site(port, namespace="/arm1", publish=("/news",)) as site:
            site.graph.advertise(site.part, "/news", STRING)
            await until(lambda: viewer.graph.topic_type("/arm1/news") == STRING)
        await until(lambda: not viewer.graph.publishers("/arm1/news"))


async def test_other_domains_are_neither_seen_nor_heard() -> None:
    port = free_port()
    async with Site(port, domain_id=7, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine:
            await asyncio.sleep(0.1)
            assert machine.tokens == set()


async def test_the_network_is_left_at_once_with_all_that_was_shared(caplog: pytest.LogCaptureFixture) -> None:
    port = free_port()
    with_machine = Site(port, publish=("/news",), subscribe=("/chat",), offer=("/arm/*",))
    async with with_machine as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine:
            machine.announce_topic("/chat", STRING)
            await until(lambda: machine.has_token("/MS/") and machine.has_token("/MP/%/%/armbridge"))
            await site.bridge.close()
            await until(lambda: not machine.has_token("armbridge"))
    assert site.graph.publishers("/chat") == site.graph.subscribers("/news") == []
    assert "the network was not left in time" not in caplog.text


def with_certificate(authority: Pair, folder: Path) -> Path:
    """zenoh's file of a machine that has a certificate, as the page shows it."""
    machine = make_signed_pair(folder, authority)
    (text,) = blocks(ROOT / "docs" / "zenoh.md", "json5")
    paths = {
        "authority.pem": authority.certificate,
        "machine.pem": machine.certificate,
        "machine.key": machine.key,
    }
    for name, path in paths.items():
        text = text.replace(f'"{name}"', f'"{path}"')
    (folder / "zenoh.json5").write_text(text)
    return folder / "zenoh.json5"


async def test_with_certificates_only_who_has_one_takes_part(tmp_path: Path) -> None:
    authority, port = make_pair(tmp_path / "authority", "lab"), free_port()
    stranger = tmp_path / "zenoh.json5"
    stranger.write_text(f'{{ transport: {{ link: {{ tls: {{ root_ca_certificate: "{authority.certificate}" }} }} }} }}')
    arm, viewer = (with_certificate(authority, tmp_path / name) for name in ("arm", "viewer"))
    connect: dict[str, Any] = {"connect": (f"tls/localhost:{port}",), "subscribe": ("/news",)}
    async with Site(listen=(f"tls/127.0.0.1:{port}",), config_file=arm, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        async with Site(config_file=stranger, **connect) as other, Site(config_file=viewer, **connect) as known:
            await until(lambda: known.graph.topic_type("/news") == STRING)
            await asyncio.sleep(0.2)
            assert other.graph.topic_type("/news") is None


async def test_a_bridge_that_was_never_opened_closes() -> None:
    await Site(free_port()).bridge.close()


def test_who_has_no_zenoh_is_told_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_config.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigurationError, match="pip install"):
        Site(free_port())
