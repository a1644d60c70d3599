"""What holds for every test."""

from __future__ import annotations

import pytest
from hypothesis import settings

# Imported before any test imports websockets: sets what that package reads when it is imported.
import server  # noqa: F401

# How long an example takes depends on the machine and on what else it does; no test is about that.
settings.register_profile("no-deadline", deadline=None)
settings.load_profile("no-deadline")


def pytest_addoption(parser: pytest.Parser) -> None:
    """The one option that moves metal; tests/robot/test_arm_contract.py says what it does and how far it goes."""
    parser.addoption(
        "--arm",
        metavar="PORT,CALIBRATION",
        help="run the arm's contract on a real arm as well: serial port, and lerobot calibration (id or file)",
    )
