"""Programs that drive the server as other people's clients do; each prints what it heard as one JSON object."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any


def heard_by(python: str | Path, scenario: Path, *arguments: str, timeout_s: float = 120.0) -> dict[str, Any]:
    """What a scenario heard, step by step.

    Args:
        python: the interpreter with the client in it; this checkout is not on its path.
        scenario: the program.
        arguments: its arguments.
        timeout_s: how long it may take [s].
    """
    done = subprocess.run(
        [str(python), str(scenario), *arguments],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
    )
    assert done.returncode == 0, done.stderr + done.stdout
    heard: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return heard
