"""What is new is found at once: the tests would wait for nothing else."""

from __future__ import annotations

import pytest

from server.zenoh import session_thread, sharing


@pytest.fixture(autouse=True)
def quick_refresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "REFRESH_PERIOD_S", 0.02)


@pytest.fixture(autouse=True)
def patient_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is no network that stands still."""
    monkeypatch.setattr(session_thread, "CLOSE_TIMEOUT_S", 30.0)
