"""lerobot opens and trains on datasets that the server has exported.

lerobot needs torch, and an environment of its own: ``make test-lerobot`` makes it and runs this.
"""

import json
import os
import subprocess
from pathlib import Path

from tests.lerobot.test_robot import BIN, COMMAND_TIMEOUT_S, SCENARIO, pytestmark
from tests.server.datasets.conftest import in_order
from tests.server.datasets.test_export import MARKED, exported
from tests.server.recordings import record

__all__ = ["pytestmark"]


def test_lerobot_opens_an_exported_dataset_with_its_video(tmp_path: Path) -> None:
    exported(tmp_path / "data", record(tmp_path / "run.mcap", in_order(MARKED)))
    done = subprocess.run(
        [str(BIN / "python"), str(SCENARIO), "open", str(tmp_path / "data")],
        capture_output=True,
        text=True,
        timeout=COMMAND_TIMEOUT_S,
        check=False,
        env={**os.environ, "HF_HUB_OFFLINE": "1"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    opened = json.loads(done.stdout.splitlines()[-1])
    assert (opened["episodes"], opened["frames"], opened["task"]) == (2, 27, "drop it")
    assert opened["image"][0] == 3
