"""The wheel of the client in an empty environment of the oldest and the newest Python; our own is between."""

import os
import shutil
from pathlib import Path

import pytest

from harness.server import ROOT, RunningServer
from tests.helpers.programs import UV, environment_with, run

PYENV = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
MOST_BYTES = 5_000_000

# Without asyncio's log lines about callbacks of over 0.1 s, which a busy machine has.
PROGRAM = """
import logging
import sys
from armbridge_client import GoalRefused, connect
logging.getLogger("asyncio").addFilter(lambda record: "took" not in record.getMessage())
with connect(sys.argv[1]) as arm:
    arm.plan("ready").execute()
    try:
        arm.move_to(0.9, 0.0, 0.1)
    except GoalRefused as refused:
        arm.move(refused.suggestion)
    print(next(arm.states()).mode)
"""


def python(version: str) -> str | None:
    """A Python of a version, from the path or pyenv's."""
    return next(map(str, PYENV.glob(f"{version}.*/bin/python")), shutil.which(f"python{version}"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    # By way of the sdist, which therefore has all that is needed.
    run(UV, "build", "--out-dir", out, ROOT / "clients" / "python", check=True)
    (made,) = out.glob("*.whl")
    return made


@pytest.mark.parametrize("version", ["3.10", "3.13"])
def test_the_wheel_moves_the_arm(version: str, wheel: Path, server: RunningServer, tmp_path: Path) -> None:
    interpreter = python(version)
    if interpreter is None:
        pytest.skip(f"this machine has no Python {version}")
    installed = environment_with(interpreter, tmp_path / "venv", wheel)
    done = run(installed, "-W", "error", "-X", "dev", "-c", PROGRAM, server.url)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout in ("holding\n", "moving\n")
    (packages,) = tmp_path.glob("venv/lib/python*/site-packages")
    size = sum(
        each.stat().st_size for name in ("armbridge_client", "websockets") for each in packages.glob(f"{name}/**/*.*")
    )
    assert size < MOST_BYTES
