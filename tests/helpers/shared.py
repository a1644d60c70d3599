"""Reference data beside the checkout, which only tests use."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[3] / "shared" / "data"


def shared_data() -> Path:
    """The folder of reference data; skips the test where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("the reference data beside the checkout (../shared/data) is absent")
    return SHARED
