"""Packages of other distributions that have the names of armbridge's own are named at the start."""

import os
import shutil
import subprocess
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

import armbridge
from harness.server import ROOT
from server import cli
from tests.helpers.programs import run
from tests.helpers.source import PACKAGES


def distribution(folder: Path, package: str) -> None:
    """Install a distribution ``other-robots`` with one package into a folder."""
    info = folder / "other_robots-7.1.dist-info"
    for made in (info, folder / package):
        made.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other-robots\nVersion: 7.1\n")
    (info / "top_level.txt").write_text(f"{package}\n")
    (folder / package / "__init__.py").touch()


def start(home: Path, *before: Path) -> subprocess.CompletedProcess[str]:
    """Run the command of a folder with other folders before it on Python's path."""
    path = os.pathsep.join(map(str, (*before, home)))
    command = sys.executable, "-P", "-m", "armbridge", "config", "--help"
    return run(*command, cwd=home, env={**os.environ, "PYTHONPATH": path})


def test_a_package_in_the_way_is_named_with_its_distribution_or_else_by_its_path(tmp_path: Path) -> None:
    assert set(armbridge.PACKAGES) == set(PACKAGES)
    package = armbridge.PACKAGES[-1]
    distribution(tmp_path, package)
    done = start(ROOT, tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith(f"armbridge: the package {package} of other-robots 7.1 in {tmp_path / package}")
    assert "in an environment of its own" in done.stderr
    shutil.rmtree(tmp_path / "other_robots-7.1.dist-info")
    done = start(ROOT, tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(f"armbridge: the package {package} in {tmp_path / package}")


def test_a_distribution_that_has_overwritten_our_files_is_named(tmp_path: Path) -> None:
    shutil.copy(ROOT / "armbridge.py", tmp_path)
    for package in PACKAGES:
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


class Interrupted:
    """Import of the commands in which somebody presses Ctrl-C."""

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        if name == "server.cli":
            raise KeyboardInterrupt
        return None


def press_ctrl_c() -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("place", ["import", "options"])
def test_ctrl_c_before_the_command_runs_ends_it_in_a_line(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    if place == "import":
        monkeypatch.delitem(sys.modules, "server.cli")
        monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    else:
        monkeypatch.setattr(cli, "_parser", press_ctrl_c)
    with pytest.raises(SystemExit, match=r"^armbridge: stopped$"):
        armbridge.main()
