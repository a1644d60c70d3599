from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from harness.server import ROOT


def test_no_warning_is_shown_where_toppra_is_compiled(tmp_path: Path) -> None:
    """As at the first start after an installation that compiles nothing, and at each where nothing can be kept."""
    done = subprocess.run(
        [sys.executable, "-W", "always", "-c", "import planners.motions.path_timing"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPYCACHEPREFIX": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "toppra" not in done.stderr
