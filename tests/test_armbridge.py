"""Packages of other distributions that have the names of armbridge's own are named at the start."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from harness.server import ROOT
from harness.waiting import TIMEOUT_S


def distribution(folder: Path, package: str, content: str = "") -> None:
    """Install a distribution ``other-robots`` with one package into a folder."""
    info = folder / "other_robots-7.1.dist-info"
    for made in (info, folder / package):
        made.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other-robots\nVersion: 7.1\n")
    (info / "top_level.txt").write_text(f"{package}\n")
    (folder / package / "__init__.py").write_text(content)


def start(home: Path, *before: Path) -> subprocess.CompletedProcess[str]:
    """Run the command of a folder with other folders before it on Python's path."""
    path = os.pathsep.join(map(str, (*before, home)))
    return subprocess.run(
        [sys.executable, "-P", "-m", "armbridge", "config", "--help"],
        cwd=home,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


@pytest.mark.parametrize("package", ["server", "planners", "robot", "protocol"])
def test_a_package_in_the_way_is_named_with_its_distribution(tmp_path: Path, package: str) -> None:
    distribution(tmp_path, package)
    done = start(ROOT, tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(f"armbridge: the package {package} of other-robots 7.1 in {tmp_path / package}")
    assert done.stderr.count("\n") == 1
    assert "pipx install armbridge" in done.stderr


def test_a_folder_that_no_distribution_has_is_named_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "__init__.py").touch()
    done = start(ROOT, tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(f"armbridge: the package robot in {tmp_path / 'robot'}")


def test_a_distribution_that_has_overwritten_our_files_is_named(tmp_path: Path) -> None:
    shutil.copy(ROOT / "armbridge.py", tmp_path)
    for package in ("server", "planners", "robot", "protocol"):
        ignored = shutil.ignore_patterns("page", "__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    distribution(tmp_path, "robot")
    (tmp_path / "robot" / "errors.py").write_text("class DataError(Exception): ...\n")
    done = start(tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("armbridge: the package robot of other-robots 7.1 is mixed with armbridge's own")


def test_alone_the_command_runs() -> None:
    done = start(ROOT)
    assert (done.returncode, done.stderr) == (0, "")
