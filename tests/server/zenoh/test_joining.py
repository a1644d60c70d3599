from __future__ import annotations

import subprocess
import sys

from server.access.authorization import unlimited
from server.graph.topics import Graph
from server.zenoh.bridge import Bridge
from server.zenoh.joining import bridge_of
from server.zenoh.settings import ZenohSettings
from tests.helpers.zenoh_network import REGISTRY

MAX_BYTES = 10_000_000


def test_a_server_that_shares_nothing_has_no_bridge() -> None:
    assert bridge_of(ZenohSettings(), Graph(REGISTRY), unlimited(), MAX_BYTES) is None


def test_a_server_that_takes_part_has_one() -> None:
    assert isinstance(bridge_of(ZenohSettings(mode="peer"), Graph(REGISTRY), unlimited(), MAX_BYTES), Bridge)


def test_a_server_that_shares_nothing_does_not_load_zenoh() -> None:
    program = """
import sys
from server.access.authorization import unlimited
from server.graph.topics import Graph
from server.zenoh.joining import bridge_of
from server.zenoh.settings import ZenohSettings
from protocol.registry import Registry
bridge_of(ZenohSettings(), Graph(Registry.load()), unlimited(), 10_000_000)
print("zenoh" in sys.modules)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30, check=True)
    assert ran.stdout == "False\n"
