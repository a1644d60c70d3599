"""Discovery without delay: the tests would wait for nothing else."""

import pytest

from server.zenoh import bridge, session


@pytest.fixture(autouse=True)
def quick_refresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge, "REFRESH_PERIOD_S", 0.02)


@pytest.fixture(autouse=True)
def patient_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is no network that stands still."""
    monkeypatch.setattr(session, "CLOSE_TIMEOUT_S", 30.0)
