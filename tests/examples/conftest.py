"""The server of all clients, and examples run as people run them."""

import subprocess
import sys
from collections.abc import Callable

import pytest

from harness.server import CLIENT_ENVIRONMENT, ROOT
from tests.clients.conftest import server  # noqa: F401 - fixture
from tests.helpers.programs import run

EXAMPLES = ROOT / "examples"
EXAMPLE_TIMEOUT_S = 300  # the physics of a busy machine is slow

RunExample = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run_example() -> RunExample:
    """Runs an example to its end."""

    def run_one(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return run(sys.executable, EXAMPLES / name, *arguments, env=CLIENT_ENVIRONMENT, timeout_s=EXAMPLE_TIMEOUT_S)

    return run_one
