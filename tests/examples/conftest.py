"""One server for all examples, whose simulated arm moves as fast as it can, and examples run as people run them."""

import subprocess
import sys
from collections.abc import Callable

import pytest

from harness.server import CLIENT_ENVIRONMENT, ROOT, RunningServer

EXAMPLES = ROOT / "examples"
EXAMPLE_TIMEOUT_S = 60

RunExample = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def server(simulated_server: RunningServer) -> RunningServer:
    return simulated_server


@pytest.fixture
def run_example() -> RunExample:
    """Runs an example to its end."""

    def run(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, str(EXAMPLES / name), *arguments],
            env=CLIENT_ENVIRONMENT,
            capture_output=True,
            text=True,
            timeout=EXAMPLE_TIMEOUT_S,
            check=False,
        )

    return run
