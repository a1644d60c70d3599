"""What is new is found at once: the tests would wait for nothing else."""

from __future__ import annotations

import pytest

from server.zenoh import sharing


@pytest.fixture(autouse=True)
def quick_refresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "REFRESH_PERIOD_S", 0.02)
