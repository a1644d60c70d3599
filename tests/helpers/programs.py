"""Programs in interpreters of their own, among them clients of other people."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from harness.server import ROOT
from harness.waiting import TIMEOUT_S

UV = Path(sys.executable).with_name("uv")


def run(*command: str | Path, timeout_s: float = TIMEOUT_S, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, in this checkout if nothing else is said, and keep what it prints."""
    options = {"cwd": ROOT, "check": False, **options}
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, **options)


def run_python(program: str) -> subprocess.CompletedProcess[str]:
    """Run a program that uses this checkout."""
    return run(sys.executable, "-c", program)


def environment_with(python: str, folder: Path, *package: str | Path, timeout_s: float = 300) -> Path:
    """Make an environment of a Python in a folder, with a package, to whose name options may be added; return its
    interpreter.
    """
    subprocess.run([UV, "venv", "--quiet", "--python", python, folder], timeout=TIMEOUT_S, check=True)
    made = folder / "bin" / "python"
    subprocess.run([UV, "pip", "install", "--quiet", "--python", made, *package], timeout=timeout_s, check=True)
    return made


def install_with_npm(folder: Path) -> None:
    """Install what the package.json of a folder names; skips the test where that cannot be had."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    installed = run("npm", "install", "--no-audit", "--no-fund", cwd=folder)
    if installed.returncode != 0:
        pytest.skip(f"npm cannot be reached: {installed.stderr.strip().splitlines()[-1]}")


def heard_by(*scenario: str | Path, **options: Any) -> dict[str, Any]:
    """Return the messages that a scenario heard, step by step; this checkout is not on its interpreter's path."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = run(*scenario, **{"env": environment, "cwd": None, **options})
    assert done.returncode == 0, done.stderr + done.stdout
    heard: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return heard
