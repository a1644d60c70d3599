"""One server for all examples, whose simulated arm moves as fast as it can, and examples run as people run them."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from harness.server import CLIENT_ENVIRONMENT, FAST, ROOT, RunningServer
from tests.helpers.programs import run

EXAMPLES = ROOT / "examples"
EXAMPLE_TIMEOUT_S = 300  # the physics of a busy machine is slow

RunExample = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="package")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    states: Path = tmp_path_factory.mktemp("data") / "states.json"
    with RunningServer(settings={**FAST, "ARMBRIDGE_GOALS__NAMED_STATES_FILE": str(states)}) as running:
        yield running


@pytest.fixture
def run_example() -> RunExample:
    """Runs an example to its end."""

    def run_one(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return run(sys.executable, EXAMPLES / name, *arguments, env=CLIENT_ENVIRONMENT, timeout_s=EXAMPLE_TIMEOUT_S)

    return run_one
