"""The wheel in an empty environment, with what its own metadata require: serve, page, a goal, stop.

``make release`` names its wheel in WHEEL; else one is built.
"""

import os
import re
import signal
import sys
import urllib.request
from pathlib import Path

import pytest

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.clients.test_wheel import build
from tests.helpers.programs import environment_with, run, run_python
from tests.test_readme import blocks


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with nothing but the wheel and what it requires, in the versions of the lock."""
    if "WHEEL" in os.environ:
        wheel = ROOT / os.environ["WHEEL"]
    else:
        out = tmp_path_factory.mktemp("built")
        done = build(ROOT, out)
        assert done.returncode == 0, done.stderr
        (wheel,) = out.glob("*.whl")
    made = tmp_path_factory.mktemp("environment") / "venv"
    # What the lock leaves out, the metadata require.
    locked = ["--no-verify-hashes", "--constraint", ROOT / "requirements.lock"]
    environment_with(sys.executable, made, *locked, wheel, timeout_s=600)
    return made


def test_it_says_its_version_and_that_of_its_page(environment: Path) -> None:
    (version,) = re.findall(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    done = run(environment / "bin/armbridge", "--version")
    assert done.stdout == f"armbridge {version}, page {version}\n"


def test_it_brings_its_docs(environment: Path) -> None:
    assert (environment / "share/doc/armbridge/docs/install.md").is_file()


def test_it_serves_its_page_carries_out_a_goal_and_stops(environment: Path) -> None:
    with RunningServer(program=environment / "bin/armbridge") as server:
        with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/", timeout=TIMEOUT_S) as response:
            assert (response.status, b'type="module"' in response.read()) == (200, True)
        program = blocks(ROOT / "README.md", "python")[0].replace(":9090", f":{server.port}")
        done = run_python(program)
        assert done.stdout == "the arm is there\n", done.stderr
        code, _ = server.end(signal.SIGTERM)
        assert code == 0
        assert [line for line in server.lines if "Warning" in line] == []
