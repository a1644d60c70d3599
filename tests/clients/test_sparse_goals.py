"""Lab scripts with the least that can be said of a goal, against the server with the simulated arm."""

import sys
from pathlib import Path
from typing import Any

import pytest

from harness.server import RunningServer
from tests.helpers.programs import heard_by

SCENARIO = Path(__file__).with_name("sparse_goals_scenario.py")


@pytest.fixture(scope="module")
def answers(server: RunningServer) -> dict[str, Any]:
    """What came of each script."""
    return heard_by(sys.executable, SCENARIO, str(server.port))


def test_segments_stitched_by_hand_and_a_pose_with_a_line_are_executed(answers: dict[str, Any]) -> None:
    assert answers["stitched"] == {"segments": 3, "code": 1}
    assert answers["line"]["codes"] == [1, 1]
    assert answers["line"]["fraction"] == pytest.approx(1.0)
