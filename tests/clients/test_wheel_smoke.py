"""The wheel in an empty environment, with what its own metadata require: serve, page, a goal, stop.

``make release`` names its wheel in WHEEL; else one is built.
"""

import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from harness.server import ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.clients.test_wheel import build
from tests.helpers.programs import UV
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
    subprocess.run([UV, "venv", "--quiet", "--python", sys.executable, made], check=True, timeout=TIMEOUT_S)
    # What the lock leaves out, the metadata require.
    locked = ["--no-verify-hashes", "--constraint", ROOT / "requirements.lock"]
    command = [UV, "pip", "install", "--quiet", "--python", made / "bin/python", *locked, wheel]
    subprocess.run(command, check=True, timeout=600)
    return made


def test_it_says_its_version_and_that_of_its_page(environment: Path) -> None:
    (version,) = re.findall(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    done = subprocess.run(
        [environment / "bin/armbridge", "--version"], capture_output=True, text=True, timeout=TIMEOUT_S, check=True
    )
    assert done.stdout == f"armbridge {version}, page {version}\n"


def test_it_brings_its_docs(environment: Path) -> None:
    assert (environment / "share/doc/armbridge/docs/install.md").is_file()


def test_it_serves_its_page_carries_out_a_goal_and_stops(environment: Path) -> None:
    with RunningServer(program=environment / "bin/armbridge") as server:
        with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/", timeout=TIMEOUT_S) as response:
            assert (response.status, b'type="module"' in response.read()) == (200, True)
        program = blocks(ROOT / "README.md", "python")[0].replace(":9090", f":{server.port}")
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert done.stdout == "the arm is there\n", done.stderr
        code, _ = server.end(signal.SIGTERM)
        assert code == 0
        assert [line for line in server.lines if "Warning" in line] == []
